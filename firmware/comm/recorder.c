#include "comm/recorder.h"

#include <stddef.h>
#include <string.h>

#include "comm/status.h"

#define OPERATION_MEMORY 0x01u
#define OPERATION_VARIABLE 0x02u
#define OPERATION_START 0x03u
#define OPERATION_STOP 0x04u

#define QUERY_DESCRIPTION 0x81u
#define QUERY_LIMITS 0x82u
#define QUERY_INFO 0x83u
#define QUERY_STATUS 0x84u

#define SIGN UINT32_C(0x80000000)

typedef enum {
    RECORDER_NOT_CONFIGURED = 0,
    RECORDER_EMPTY = 1,
    RECORDER_RUNNING = 2,
    RECORDER_STOPPED = 3, /* stopped before the memory was full */
    RECORDER_FULL = 4,
} recorder_state_t;

/* ---- configuration ---------------------------------------------------------------------------------------------- */

void recorder_init(recorder_t *recorder, const recorder_app_t *app, recorder_memory_t *memory)
{
    (void)memset(recorder, 0, sizeof *recorder);
    recorder->app = *app;
    recorder->memory = memory;
}

static bool complete(const payload_reader_t *operand) { return !operand->missing && operand->remaining == 0; }

static void discard(recorder_t *recorder)
{
    recorder->running = false;
    recorder->slots = 0;
    for (uint16_t k = 0; k < RECORDER_SLOTS; k++) {
        recorder->memory->slot[k].source = NULL;
    }
    recorder->configured = false;
    recorder->started = false;
}

/* 01: u8 slots, SIZE points, SIZE points before the trigger, SIZE divider. Allowed while recording. */
static fm_status_t reserve(recorder_t *recorder, payload_reader_t *operand)
{
    const uint8_t slots = payload_get_u8(operand);
    const uint32_t total = payload_get_unsigned(operand);
    const uint32_t before = payload_get_unsigned(operand);
    const uint32_t divider = payload_get_unsigned(operand);
    if (!complete(operand) || slots > RECORDER_SLOTS) {
        return FM_BAD_SIZE;
    }
    recorder_memory_t *memory = recorder->memory;
    if (memory->owner != NULL && memory->owner != recorder) {
        if (memory->owner->running) {
            return FM_BUSY;
        }
        discard(memory->owner);
    }
    discard(recorder);
    memory->owner = recorder;
    recorder->slots = slots;
    recorder->total = total;
    recorder->before = before;
    recorder->divider = divider;
    return FM_OK;
}

/* Read the threshold that follows in the request; its type is given by `slot`. */
static fm_status_t get_threshold(recorder_slot_t *slot, const tsa_space_t *space, payload_reader_t *operand)
{
    const bool is_signed = (slot->mode & RECORDER_MODE_TYPE) == RECORDER_TYPE_SIGNED;
    slot->bias = is_signed ? SIGN >> (slot->size < 4 ? 32u - 8u * slot->size : 0u) : 0;
    if ((slot->mode & RECORDER_MODE_LIMIT_VARIABLE) != 0) {
        const uint32_t address = payload_get_unsigned(operand);
        uint8_t cell = 0;
        slot->limit = operand->missing ? NULL : tsa_live(space, address, slot->size, &cell);
        return slot->limit != NULL || operand->missing ? FM_OK : FM_DENIED;
    }
    if (!is_signed) {
        slot->threshold = payload_get_unsigned(operand);
        return FM_OK;
    }
    const int32_t threshold = payload_get_signed(operand);
    slot->threshold_upper = slot->bias ^ (threshold < 0 ? UINT32_MAX : 0);
    if (slot->size > 4) {
        slot->threshold = (uint32_t)threshold;
    } else { /* a threshold below the range of the variable is clamped to 0 */
        const int64_t shifted = (int64_t)threshold + slot->bias;
        slot->threshold = shifted < 0 ? 0 : (uint32_t)shifted;
    }
    return FM_OK;
}

/* 02: u8 slot, ADDR, u8 size, u8 trigger, threshold. Checked: slot, state, length and size, access, type, threshold. */
static fm_status_t set_slot(recorder_t *recorder, const tsa_space_t *space, payload_reader_t *operand)
{
    const uint8_t index = payload_get_u8(operand);
    if (!operand->missing && index >= recorder->slots) {
        return FM_BAD_INSTANCE;
    }
    if (recorder->configured) {
        return FM_BUSY;
    }
    recorder_slot_t slot = {0};
    const uint32_t address = payload_get_unsigned(operand);
    slot.size = payload_get_u8(operand);
    slot.mode = payload_get_u8(operand);
    if (operand->missing || !tsa_is_variable_size(slot.size)) {
        return FM_BAD_SIZE;
    }
    slot.source = tsa_live(space, address, slot.size, &slot.cell);
    if (slot.source == NULL) {
        return FM_DENIED;
    }
    if ((slot.mode & RECORDER_MODE_TYPE) == RECORDER_TYPE_FLOAT) {
        return slot.size < 4 ? FM_BAD_SIZE : FM_NO_FLOAT;
    }
    const fm_status_t status = get_threshold(&slot, space, operand);
    if (fm_is_error(status)) {
        return status;
    }
    if (!complete(operand)) {
        return FM_BAD_SIZE;
    }
    slot.direct = slot.limit == NULL && slot.cell == slot.size && slot.size > 1 ? slot.size : 0;
    recorder->memory->slot[index] = slot;
    return FM_OK;
}

/* The sampling data is written through volatile accesses, in statement order, because the loop may interrupt between
 * any two. */
static void make_moves(recorder_t *recorder, uint8_t cell)
{
    volatile recorder_sampling_t *sampling = &recorder->memory->sampling;
    uint16_t moves = 0;
    uint16_t triggers = 0;
    for (uint16_t k = 0; k < recorder->slots; k++) {
        recorder_slot_t *slot = &recorder->memory->slot[k];
        if ((slot->mode & RECORDER_MODE_TYPE) != RECORDER_TYPE_NONE) {
            sampling->trigger[triggers++] = slot;
        }
        if ((slot->mode & RECORDER_MODE_NOT_STORED) == 0) {
            for (uint16_t done = 0; done < slot->size; done = (uint16_t)(done + cell)) {
                sampling->source[moves++] = slot->source + done;
            }
        }
    }
    sampling->cell = cell;
    sampling->trigger_end = recorder->memory->sampling.trigger + triggers;
}

/* Complete the configuration if all slots are set and at least one is stored. False: it is not complete. */
static bool complete_configuration(recorder_t *recorder)
{
    if (recorder->configured) {
        return true;
    }
    if (recorder->memory->owner != recorder) {
        return false; /* the slots belong to an earlier configuration */
    }
    uint16_t point = 0;
    uint8_t stored = 0;
    uint8_t cell = 4;
    for (uint16_t k = 0; k < recorder->slots; k++) {
        const recorder_slot_t *slot = &recorder->memory->slot[k];
        if (slot->source == NULL) {
            return false;
        }
        if ((slot->mode & RECORDER_MODE_NOT_STORED) == 0) {
            const uint8_t own = slot->size < slot->cell ? slot->size : slot->cell;
            cell = own < cell ? own : cell;
            point = (uint16_t)(point + slot->size);
            stored++;
        }
    }
    const recorder_memory_t *memory = recorder->memory;
    if (stored == 0 || point > memory->size) {
        return false;
    }
    const uint32_t fitting = memory->size / point;
    if (recorder->total == 0 || recorder->total > fitting) {
        recorder->total = fitting;
    }
    if (recorder->before >= recorder->total) {
        recorder->before = 0;
    }
    make_moves(recorder, cell);
    volatile recorder_sampling_t *sampling = &recorder->memory->sampling;
    sampling->divider = recorder->divider;
    sampling->next = (uint8_t *)memory->samples;
    sampling->end = sampling->next + (size_t)(recorder->total * point);
    sampling->after = (uint16_t)(recorder->total - 1u - recorder->before);
    sampling->filled = false;
    sampling->point = point;
    recorder->stored = stored;
    recorder->configured = true;
    return true;
}

static fm_status_t start(recorder_t *recorder)
{
    if (!complete_configuration(recorder)) {
        return FM_BAD_SIZE;
    }
    if (!recorder->running) {
        volatile recorder_sampling_t *sampling = &recorder->memory->sampling;
        recorder->started = true;
        sampling->next = (uint8_t *)recorder->memory->samples;
        sampling->skip = 0;
        sampling->filled = false;
        sampling->armed = false;
        sampling->stopping = false;
        recorder->running = true; /* last, because the loop may interrupt before this statement */
    }
    return FM_OK;
}

static fm_status_t stop(recorder_t *recorder)
{
    if (!recorder->configured) {
        return FM_NOT_CONFIGURED;
    }
    recorder->running = false;
    return FM_OK;
}

static fm_status_t run_operation(recorder_t *recorder, const tsa_space_t *space, uint8_t code,
                                 payload_reader_t *operand)
{
    switch (code) {
    case OPERATION_MEMORY:
        return reserve(recorder, operand);
    case OPERATION_VARIABLE:
        return set_slot(recorder, space, operand);
    case OPERATION_START:
        return complete(operand) ? start(recorder) : FM_BAD_SIZE;
    case OPERATION_STOP:
        return complete(operand) ? stop(recorder) : FM_BAD_SIZE;
    default:
        return FM_BAD_OPERATION;
    }
}

fm_status_t recorder_configure(recorder_t *recorder, const tsa_space_t *space, payload_reader_t *operations)
{
    fm_status_t status = FM_OK;
    payload_operation_t operation;
    while (!fm_is_error(status) && payload_next_operation(operations, &operation)) {
        status = run_operation(recorder, space, operation.code, &operation.operand);
    }
    return operations->missing ? FM_BAD_SIZE : status;
}

/* ---- answers ---------------------------------------------------------------------------------------------------- */

/* State; completes the configuration first, if it can be. */
static recorder_state_t update_state(recorder_t *recorder)
{
    if (!complete_configuration(recorder)) {
        return RECORDER_NOT_CONFIGURED;
    }
    if (recorder->running) {
        return RECORDER_RUNNING;
    }
    if (!recorder->started) {
        return RECORDER_EMPTY;
    }
    return recorder->memory->sampling.filled ? RECORDER_FULL : RECORDER_STOPPED;
}

/* u8 state, u8 stored variables, ADDR samples, SIZE bytes of a point, SIZE points, SIZE index of the oldest point. */
static void put_info(recorder_t *recorder, payload_writer_t *reply)
{
    const recorder_state_t state = update_state(recorder);
    payload_put_u8(reply, (uint8_t)state);
    if (state == RECORDER_NOT_CONFIGURED) {
        const uint8_t nothing[5] = {0};
        payload_put_bytes(reply, nothing, (uint16_t)sizeof nothing);
        return;
    }
    const recorder_sampling_t *sampling = &recorder->memory->sampling;
    const uint8_t *samples = (const uint8_t *)recorder->memory->samples;
    const uint16_t next = (uint16_t)((uint16_t)(sampling->next - samples) / sampling->point);
    const bool all = sampling->filled || !recorder->started;
    payload_put_u8(reply, recorder->stored);
    payload_put_unsigned(reply, TSA_SAMPLES_BASE);
    payload_put_unsigned(reply, sampling->point);
    payload_put_unsigned(reply, all ? recorder->total : next);
    payload_put_unsigned(reply, all ? next : 0);
}

fm_status_t recorder_query(recorder_t *recorder, uint8_t operation, payload_writer_t *reply)
{
    switch (operation) {
    case QUERY_DESCRIPTION:
        payload_put_bytes(reply, (const uint8_t *)recorder->app.name, (uint16_t)strlen(recorder->app.name));
        break;
    case QUERY_LIMITS:
        payload_put_unsigned(reply, recorder->memory->size);
        payload_put_unsigned(reply, recorder->app.timebase);
        payload_put_unsigned(reply, 0); /* bytes of sample memory used per recorder and per slot: none */
        payload_put_unsigned(reply, 0);
        break;
    case QUERY_INFO:
        put_info(recorder, reply);
        break;
    case QUERY_STATUS:
        payload_put_u8(reply, (uint8_t)update_state(recorder));
        break;
    default:
        return FM_BAD_OPERATION;
    }
    return FM_OK_VARIABLE;
}

const uint8_t *recorder_samples(const recorder_memory_t *memory, uint32_t address, uint32_t size)
{
    const recorder_t *owner = memory->owner;
    if (owner == NULL || owner->running || !tsa_inside(address, size, TSA_SAMPLES_BASE, memory->size)) {
        return NULL;
    }
    return (const uint8_t *)memory->samples + (size_t)(address - TSA_SAMPLES_BASE);
}
