#include "comm/freemaster.h"

#include <stddef.h>
#include <string.h>

#include "comm/getconfig.h"
#include "comm/payload.h"
#include "comm/status.h"

#define SCOPE_INDEX 0u     /* the server has one scope */
#define WRITE_MASKED 0x01u /* flag of WRITEMEM; other flags are ignored */
#define SCOPE_BYTES (8 * SCOPE_SLOTS)
#define MEMORY_SIZE_MAX UINT32_C(0x10000) /* written() reports 16-bit offsets */

#if SCOPE_BYTES > 252
#error "a full scope does not fit into one answer"
#endif

/* ---- memory ---------------------------------------------------------------------------------------------------- */

/* The loops stop latching and publishing only while variables are copied: strings and table are constant, and the table
 * takes long to compose. */
static void copy_out(freemaster_t *server, const tsa_place_t *place, uint8_t *data)
{
    const bool live = place->region == TSA_REGION_VARIABLES;
    if (live) {
        server->app.lock(server->app.context, true);
    }
    tsa_copy(&server->space, place, data);
    if (live) {
        server->app.lock(server->app.context, false);
    }
}

/* Write and report the smallest range that contains all written bytes: with a mask that selects one element of an
 * array, the other elements must not count as written. */
static fm_status_t copy_in(freemaster_t *server, const tsa_place_t *place, const uint8_t *data, const uint8_t *mask)
{
    uint8_t *memory = server->space.memory + (size_t)place->offset;
    uint16_t first = 0;
    uint16_t end = place->size;
    if (mask != NULL) {
        while (first < end && mask[first] == 0) {
            first++;
        }
        while (end > first && mask[end - 1u] == 0) {
            end--;
        }
    }
    if (first == end) {
        return FM_OK;
    }
    const freemaster_app_t *app = &server->app;
    const uint16_t offset = (uint16_t)(place->offset + first);
    const uint16_t size = (uint16_t)(end - first);
    app->lock(app->context, true);
    const bool accepted = app->accepts(app->context, offset, data + first, mask != NULL ? mask + first : NULL, size);
    if (accepted) {
        for (uint16_t i = first; i < end; i++) {
            const unsigned select = mask != NULL ? mask[i] : 0xFFu;
            memory[i] = (uint8_t)((memory[i] & ~select) | (data[i] & select));
        }
        app->written(app->context, offset, size);
    }
    app->lock(app->context, false);
    return accepted ? FM_OK : FM_OUT_OF_RANGE;
}

fm_status_t freemaster_read(freemaster_t *server, uint32_t address, uint8_t *data, uint16_t size)
{
    tsa_place_t place;
    const uint8_t *samples = recorder_samples(&server->samples, address, size);
    if (samples != NULL) {
        memcpy(data, samples, size);
        return FM_OK;
    }
    if (!tsa_readable(&server->space, address, size, &place)) {
        return FM_DENIED;
    }
    copy_out(server, &place, data);
    return FM_OK;
}

fm_status_t freemaster_write(freemaster_t *server, uint32_t address, const uint8_t *data, const uint8_t *mask,
                             uint16_t size)
{
    tsa_place_t place;
    if (!tsa_writable(&server->space, address, size, &place)) {
        return FM_DENIED;
    }
    return copy_in(server, &place, data, mask);
}

uint8_t freemaster_level(const freemaster_t *server) { return server->access.level; }

void freemaster_finish_command(freemaster_t *server, uint8_t code, const uint8_t *result, uint16_t size)
{
    app_command_finish(&server->app_command, code, result, size);
}

uint16_t freemaster_console_room(const freemaster_t *server) { return pipe_room(&server->pipe); }

void freemaster_print(freemaster_t *server, const uint8_t *text, uint16_t size)
{
    pipe_write(&server->pipe, text, size);
}

/* ---- commands -------------------------------------------------------------------------------------------------- */

static fm_status_t get_configuration(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    return getconfig_answer(&server->app, request, reply);
}

/* Checks in the order of the vendor's server: access first, then the size. */
static fm_status_t read_range(freemaster_t *server, uint32_t address, uint32_t size, payload_writer_t *reply)
{
    tsa_place_t place;
    const uint8_t *samples = recorder_samples(&server->samples, address, size);
    if (freemaster_level(server) < ACCESS_VIEW) {
        return FM_PASSWORD_NEEDED;
    }
    if (samples == NULL && !tsa_readable(&server->space, address, size, &place)) {
        return FM_DENIED;
    }
    uint8_t *room = payload_reserve(reply, size);
    if (room == NULL) {
        return FM_ANSWER_TOO_LONG;
    }
    if (samples != NULL) {
        memcpy(room, samples, (size_t)size);
    } else {
        copy_out(server, &place, room);
    }
    return FM_OK;
}

static fm_status_t read_memory(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    const uint32_t address = payload_get_unsigned(request);
    const uint32_t size = payload_get_unsigned(request);
    return request->missing ? FM_BAD_SIZE : read_range(server, address, size, reply);
}

static fm_status_t read_memory_from_base(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    const int32_t offset = payload_get_signed(request);
    const uint32_t size = payload_get_unsigned(request);
    return request->missing ? FM_BAD_SIZE : read_range(server, TSA_VARIABLES_BASE + (uint32_t)offset, size, reply);
}

/* Stricter than the vendor's server: data and mask must have been received, otherwise bytes of older messages would be
 * written. */
static fm_status_t write_memory(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    const uint8_t flags = payload_get_u8(request);
    const uint32_t address = payload_get_unsigned(request);
    const uint32_t size = payload_get_unsigned(request);
    tsa_place_t place;
    if (request->missing) {
        return FM_BAD_SIZE;
    }
    if (freemaster_level(server) < ACCESS_COMMAND) {
        return FM_PASSWORD_NEEDED;
    }
    if (!tsa_writable(&server->space, address, size, &place)) {
        return FM_DENIED;
    }
    if (freemaster_level(server) <
        server->app.level_to_write(server->app.context, (uint16_t)place.offset, place.size)) {
        return FM_PASSWORD_NEEDED;
    }
    const uint8_t *data = payload_take(request, size);
    const uint8_t *mask = (flags & WRITE_MASKED) != 0 ? payload_take(request, size) : NULL;
    if (request->missing) {
        return FM_BAD_SIZE;
    }
    return copy_in(server, &place, data, mask);
}

static fm_status_t check_scope(payload_reader_t *request)
{
    const uint8_t index = payload_get_u8(request);
    if (request->missing) {
        return FM_BAD_SIZE;
    }
    return index == SCOPE_INDEX ? FM_OK : FM_BAD_INSTANCE;
}

static fm_status_t set_scope(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    const fm_status_t status = check_scope(request);
    return fm_is_error(status) ? status : scope_configure(&server->scope, &server->space, request);
}

static fm_status_t read_scope(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    fm_status_t status = check_scope(request);
    if (!fm_is_error(status)) {
        server->app.lock(server->app.context, true); /* one section: all slots are of one moment */
        status = scope_read(&server->scope, &server->space, reply);
        server->app.lock(server->app.context, false);
    }
    return status;
}

/* The recorder that a request addresses; NULL if there is none with that index. */
static recorder_t *find_recorder(freemaster_t *server, payload_reader_t *request)
{
    const uint8_t index = payload_get_u8(request);
    return !request->missing && index < FREEMASTER_RECORDERS ? &server->recorder[index] : NULL;
}

static fm_status_t set_recorder(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    recorder_t *recorder = find_recorder(server, request);
    if (recorder == NULL) {
        return request->missing ? FM_BAD_SIZE : FM_BAD_INSTANCE;
    }
    return recorder_configure(recorder, &server->space, request);
}

static fm_status_t get_recorder(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    recorder_t *recorder = find_recorder(server, request);
    const uint8_t operation = recorder != NULL ? payload_get_u8(request) : (uint8_t)0;
    if (request->missing) {
        return FM_BAD_SIZE;
    }
    return recorder != NULL ? recorder_query(recorder, operation, reply) : FM_BAD_INSTANCE;
}

/* There is one table; an address of 0 at the next index ends the client's enumeration. */
static fm_status_t get_tsa_info(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    const uint32_t index = payload_get_unsigned(request);
    if (request->missing) {
        return FM_BAD_SIZE;
    }
    payload_put_u8(reply, TSA_FLAGS);
    payload_put_unsigned(reply, index == 0 ? tsa_table_size(server->space.table) : 0);
    payload_put_unsigned(reply, index == 0 ? TSA_TABLE_BASE : 0);
    return FM_OK_VARIABLE;
}

/* Stricter than the vendor's server, which counts from any address up to the next 00. */
static fm_status_t get_string_length(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    const uint32_t address = payload_get_unsigned(request);
    uint16_t length = 0;
    if (request->missing) {
        return FM_BAD_SIZE;
    }
    if (!tsa_string_length(server->space.table, address, &length)) {
        return FM_DENIED;
    }
    payload_put_unsigned(reply, length);
    return FM_OK_VARIABLE;
}

static fm_status_t exchange_pipe(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    return pipe_exchange(&server->pipe, request, reply);
}

static fm_status_t get_pipe(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    return pipe_query(&server->pipe, request, reply);
}

static fm_status_t challenge_client(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    const uint32_t nonce = server->app.nonce(server->app.context);
    return access_challenge(&server->access, nonce, request, reply);
}

static fm_status_t check_password(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    return access_prove(&server->access, request, reply);
}

static fm_status_t send_app_command(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    return app_command_send(&server->app_command, request);
}

static fm_status_t get_app_command_status(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    (void)request;
    payload_put_u8(reply, app_command_poll(&server->app_command, server->app.command, server->app.context));
    return FM_OK;
}

static fm_status_t get_app_command_data(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply)
{
    return app_command_data(&server->app_command, request, reply);
}

/* ---- dispatch -------------------------------------------------------------------------------------------------- */

/* A handler reads its request, writes the data of its answer and returns the status. */
typedef struct {
    uint8_t code;
    fm_status_t (*run)(freemaster_t *server, payload_reader_t *request, payload_writer_t *reply);
} command_t;

static const command_t commands[] = {
    {0x20, get_configuration},
    {0x21, read_memory},
    {0x22, read_memory_from_base},
    {0x23, write_memory},
    {0x24, set_recorder},
    {0x25, get_recorder},
    {0x26, set_scope},
    {0x27, read_scope},
    {0x28, exchange_pipe},
    {0x29, get_tsa_info},
    {0x2A, get_string_length},
    {0x2C, challenge_client},
    {0x2D, check_password},
    {0x2F, get_pipe},
    {0x30, send_app_command},
    {0x31, get_app_command_status},
    {0x32, get_app_command_data},
};
#define COMMANDS (sizeof commands / sizeof commands[0])

static fm_status_t run_command(freemaster_t *server, payload_writer_t *reply)
{
    const frame_receiver_t *frame = &server->receiver;
    payload_reader_t request = {frame->payload, frame->size, false};
    for (size_t i = 0; i < COMMANDS; i++) {
        if (commands[i].code == frame->command) {
            const fm_status_t status = commands[i].run(server, &request, reply);
            return reply->full && !fm_is_error(status) ? FM_ANSWER_TOO_LONG : status;
        }
    }
    return FM_UNKNOWN_COMMAND;
}

static void execute(freemaster_t *server)
{
    payload_writer_t reply = {frame_data(&server->transmitter), FRAME_DATA_MAX, 0, false};
    const fm_status_t status = run_command(server, &reply);
    server->statistics.requests++;
    if (fm_is_error(status)) {
        server->statistics.refused++;
    }
    frame_send(&server->transmitter, status, reply.size);
}

static void answer(freemaster_t *server, frame_event_t event)
{
    switch (event) {
    case FRAME_COMPLETE:
        execute(server);
        break;
    case FRAME_TOO_LONG:
        server->statistics.too_long++;
        frame_send(&server->transmitter, FM_REQUEST_TOO_LONG, 0);
        break;
    case FRAME_CORRUPT:
        server->statistics.bad_crc++;
        frame_send(&server->transmitter, FM_BAD_CHECKSUM, 0);
        break;
    default: /* frame aborted */
        server->statistics.aborted++;
        break;
    }
}

void freemaster_init(freemaster_t *server, const freemaster_app_t *app)
{
    const freemaster_statistics_t none = {0, 0, 0, 0, 0, 0};
    server->app = *app;
    server->space.table = app->tsa;
    server->space.memory = app->memory;
    server->space.memory_size = app->memory_size < MEMORY_SIZE_MAX ? app->memory_size : MEMORY_SIZE_MAX;
    server->space.live = app->live;
    server->space.live_size = app->live_size;
    (void)memset(&server->samples, 0, sizeof server->samples);
    server->samples.samples = app->samples;
    server->samples.size = app->samples_size;
    for (uint16_t i = 0; i < FREEMASTER_RECORDERS; i++) {
        recorder_init(&server->recorder[i], &app->recorder[i], &server->samples);
    }
    server->statistics = none;
    server->received = FRAME_NOTHING;
    frame_receiver_init(&server->receiver);
    frame_transmitter_init(&server->transmitter);
    scope_init(&server->scope);
    app_command_init(&server->app_command);
    access_init(&server->access, &app->passwords);
    pipe_init(&server->pipe, app->console);
}

/* Bytes that arrive while an answer is being sent are lost. */
static frame_event_t receive(freemaster_t *server, uint8_t byte)
{
    if (frame_is_sending(&server->transmitter)) {
        server->statistics.bytes_lost++;
        return FRAME_NOTHING;
    }
    return frame_receive(&server->receiver, byte);
}

static void transmit(freemaster_t *server, hal_t *hal)
{
    uint8_t byte;
    while (frame_peek(&server->transmitter, &byte) && hal_serial_put(hal, byte)) {
        frame_advance(&server->transmitter);
    }
}

/* Read bytes up to the next event, and keep that event. */
static void fetch(freemaster_t *server, hal_t *hal)
{
    uint8_t byte;
    while (server->received == FRAME_NOTHING && hal_serial_get(hal, &byte)) {
        server->received = receive(server, byte);
    }
}

void freemaster_listen(freemaster_t *server, hal_t *hal)
{
    fetch(server, hal);
    transmit(server, hal);
}

void freemaster_poll(freemaster_t *server, hal_t *hal)
{
    fetch(server, hal);
    while (server->received != FRAME_NOTHING) {
        answer(server, server->received);
        server->received = FRAME_NOTHING;
        fetch(server, hal);
    }
    transmit(server, hal);
}
