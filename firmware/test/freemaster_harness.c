#include "freemaster_harness.h"

#include <stdlib.h>
#include <string.h>

#include "comm/sha1.h"

#define SCRAMBLE 0xA5u
#define TUNING 0x100u /* memory from this offset on requires the tuning level */

struct hal {
    uint8_t in[HARNESS_LINE];
    uint8_t out[HARNESS_LINE];
    uint16_t in_at, in_end, out_end;
    uint16_t put_room, put_left;
};

struct harness {
    hal_t hal;
    freemaster_t server;
    /* Exactly the sizes passed to the server, so that a sanitizer detects any access beyond them. */
    uint8_t *memory;
    uint8_t *live;
    uint32_t *samples;
    bool locked;
    bool refusing;
    uint16_t accepted_offset, accepted_size;
    uint16_t violations;
    uint16_t events;
    uint16_t event[3 * HARNESS_EVENTS];
    uint8_t password[ACCESS_LEVELS][SHA1_SIZE];
    uint32_t nonces;
};

bool hal_serial_get(hal_t *hal, uint8_t *byte)
{
    if (hal->in_at == hal->in_end) {
        hal->in_at = 0;
        hal->in_end = 0;
        return false;
    }
    *byte = hal->in[hal->in_at++];
    return true;
}

bool hal_serial_put(hal_t *hal, uint8_t byte)
{
    if (hal->put_left == 0 || hal->out_end == HARNESS_LINE) {
        return false;
    }
    hal->put_left--;
    hal->out[hal->out_end++] = byte;
    return true;
}

static void note(harness_t *harness, harness_event_t code, uint16_t offset, uint16_t size)
{
    if (harness->events < HARNESS_EVENTS) {
        uint16_t *event = harness->event + 3 * harness->events++;
        event[0] = (uint16_t)code;
        event[1] = offset;
        event[2] = size;
    }
}

/* The memory is valid only while the server is locked: bytes copied at any other time have wrong values. */
static void scramble(harness_t *harness)
{
    for (uint16_t i = 0; i < fixture_memory_size; i++) {
        harness->memory[i] ^= SCRAMBLE;
    }
}

static void lock(void *context, bool on)
{
    harness_t *harness = context;
    if (harness->locked == on) {
        harness->violations++;
        return;
    }
    harness->locked = on;
    scramble(harness);
    note(harness, on ? EVENT_LOCK : EVENT_UNLOCK, 0, 0);
}

/* Accesses every byte of its argument, so that a sanitizer detects an access beyond them. */
static bool accepts(void *context, uint16_t offset, const uint8_t *data, const uint8_t *mask, uint16_t size)
{
    harness_t *harness = context;
    uint8_t selected = 0;
    for (uint16_t i = 0; i < size; i++) {
        const uint8_t select = mask != NULL ? mask[i] : 0xFFu;
        selected = (uint8_t)(selected | select | (data[i] & select));
    }
    if (!harness->locked || selected == 0 || offset >= fixture_memory_size || size > fixture_memory_size - offset) {
        harness->violations++;
    }
    harness->accepted_offset = offset;
    harness->accepted_size = size;
    return !harness->refusing;
}

static void written(void *context, uint16_t offset, uint16_t size)
{
    harness_t *harness = context;
    if (!harness->locked || harness->refusing || offset != harness->accepted_offset || size != harness->accepted_size) {
        harness->violations++;
    }
    note(harness, EVENT_WRITTEN, offset, size);
}

/* Command 0x11 returns the complements of its arguments; other codes are their own results without data (FE: pending). */
static uint8_t command(void *context, uint8_t code, const uint8_t *arguments, uint16_t size, uint8_t *result,
                       uint16_t *result_size)
{
    harness_t *harness = context;
    note(harness, EVENT_COMMAND, code, size);
    if (harness->locked || *result_size < size) {
        harness->violations++;
    }
    if (code != 0x11) {
        *result_size = 0;
        return code;
    }
    for (uint16_t i = 0; i < size; i++) {
        result[i] = (uint8_t)(arguments[i] ^ 0xFFu);
    }
    *result_size = size;
    return 0x42;
}

static uint32_t nonce(void *context)
{
    harness_t *harness = context;
    return harness->nonces++;
}

static uint8_t level_to_write(void *context, uint16_t offset, uint16_t size)
{
    (void)context;
    return (uint32_t)offset + size > TUNING ? ACCESS_TUNE : ACCESS_COMMAND;
}

static void start(harness_t *harness, const access_passwords_t *passwords)
{
    const freemaster_app_t app = {
        .context = harness,
        .memory = harness->memory,
        .memory_size = fixture_memory_size,
        .live = harness->live,
        .live_size = fixture_live_size,
        .recorder = {{"fast", UINT32_C(1000000)}, {"slow", 0}},
        .samples = harness->samples,
        .samples_size = HARNESS_SAMPLES,
        .tsa = &fixture_table,
        .name = "servo",
        .description = "two axes in memory, nothing turns",
        .version = "4.0",
        .build = "2026-01-01",
        .lock = lock,
        .accepts = accepts,
        .written = written,
        .command = command,
        .console = "log",
        .passwords = *passwords,
        .nonce = nonce,
        .level_to_write = level_to_write,
    };
    memset(&harness->server, 0xEE, sizeof harness->server); /* init must not rely on cleared memory */
    freemaster_init(&harness->server, &app);
}

harness_t *harness_new(void)
{
    harness_t *harness = calloc(1, sizeof *harness);
    if (harness == NULL) {
        return NULL;
    }
    harness->memory = malloc(fixture_memory_size);
    harness->live = calloc(1, fixture_live_size);
    harness->samples = calloc(1, HARNESS_SAMPLES);
    if (harness->memory == NULL || harness->live == NULL || harness->samples == NULL) {
        harness_free(harness);
        return NULL;
    }
    memcpy(harness->memory, fixture_memory, fixture_memory_size);
    scramble(harness);
    harness->hal.put_room = HARNESS_LINE;

    const access_passwords_t none = {{NULL, NULL, NULL}};
    start(harness, &none);
    return harness;
}

void harness_set_passwords(harness_t *harness, const uint8_t *view, const uint8_t *command_, const uint8_t *tune)
{
    const uint8_t *given[ACCESS_LEVELS] = {view, command_, tune};
    access_passwords_t passwords;
    for (uint16_t i = 0; i < ACCESS_LEVELS; i++) {
        if (given[i] != NULL) {
            memcpy(harness->password[i], given[i], SHA1_SIZE);
        }
        passwords.password[i] = given[i] != NULL ? harness->password[i] : NULL;
    }
    start(harness, &passwords);
}

void harness_finish(harness_t *harness, uint8_t code, const uint8_t *result, uint16_t size)
{
    freemaster_finish_command(&harness->server, code, result, size);
}

void harness_print(harness_t *harness, const uint8_t *text, uint16_t size)
{
    freemaster_print(&harness->server, text, size);
}

uint8_t harness_level(const harness_t *harness) { return freemaster_level(&harness->server); }

void harness_free(harness_t *harness)
{
    if (harness != NULL) {
        free(harness->memory);
        free(harness->live);
        free(harness->samples);
        free(harness);
    }
}

void harness_set_put_room(harness_t *harness, uint16_t bytes) { harness->hal.put_room = bytes; }

void harness_set_refusing(harness_t *harness, bool refusing) { harness->refusing = refusing; }

void harness_feed(harness_t *harness, const uint8_t *data, uint16_t size)
{
    hal_t *hal = &harness->hal;
    for (uint16_t i = 0; i < size && hal->in_end < HARNESS_LINE; i++) {
        hal->in[hal->in_end++] = data[i];
    }
}

void harness_poll(harness_t *harness)
{
    harness->hal.put_left = harness->hal.put_room;
    freemaster_poll(&harness->server, &harness->hal);
    if (harness->locked) {
        harness->violations++;
    }
}

uint16_t harness_take(harness_t *harness, uint8_t *data)
{
    const uint16_t size = harness->hal.out_end;
    memcpy(data, harness->hal.out, size);
    harness->hal.out_end = 0;
    return size;
}

uint8_t harness_read(harness_t *harness, uint32_t address, uint8_t *data, uint16_t size)
{
    return freemaster_read(&harness->server, address, data, size);
}

uint8_t harness_write(harness_t *harness, uint32_t address, const uint8_t *data, const uint8_t *mask, uint16_t size)
{
    return freemaster_write(&harness->server, address, data, mask, size);
}

void harness_memory(const harness_t *harness, uint8_t *data)
{
    for (uint16_t i = 0; i < fixture_memory_size; i++) {
        data[i] = (uint8_t)(harness->memory[i] ^ SCRAMBLE);
    }
}

void harness_poke(harness_t *harness, uint16_t offset, const uint8_t *data, uint16_t size)
{
    for (uint16_t i = 0; i < size; i++) {
        harness->memory[offset + i] = (uint8_t)(data[i] ^ SCRAMBLE);
    }
}

void harness_poke_live(harness_t *harness, uint16_t offset, const uint8_t *data, uint16_t size)
{
    memcpy(harness->live + offset, data, size);
}

/* A loop accesses the memory directly. */
void harness_sample(harness_t *harness, uint16_t recorder)
{
    scramble(harness);
    recorder_sample(&harness->server.recorder[recorder]);
    scramble(harness);
}

uint16_t harness_events(harness_t *harness, uint16_t *triples)
{
    const uint16_t events = harness->events;
    memcpy(triples, harness->event, sizeof harness->event);
    harness->events = 0;
    return events;
}

uint16_t harness_violations(const harness_t *harness) { return harness->violations; }

void harness_statistics(const harness_t *harness, uint32_t values[6])
{
    const freemaster_statistics_t *statistics = &harness->server.statistics;
    values[0] = statistics->requests;
    values[1] = statistics->refused;
    values[2] = statistics->bad_crc;
    values[3] = statistics->too_long;
    values[4] = statistics->aborted;
    values[5] = statistics->bytes_lost;
}
