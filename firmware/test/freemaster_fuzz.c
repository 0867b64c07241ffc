/* The harness as a target of libFuzzer, or (FUZZ_REPLAY) as a program that runs the inputs it reads from standard input:
 * u16 size, bytes. For each input it writes the bytes sent after the last step: u16 size, bytes (little endian).
 *
 * Bits 0 to 2 of the first byte select the levels with a password. Steps follow: code, length and this number of
 * bytes:
 *   0  raw bytes on the line                 2  text printed by the application
 *   1  a frame: command and payload          3  the application finishes a command: result code and data
 *   4  one sample of a recorder per byte
 * Each complete frame must be answered by one complete frame, except after a step 0, whose bytes it may complete. No
 * step may violate the interface of the application, or change memory that is not writable. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "comm/crc8.h"
#include "comm/sha1.h"
#include "freemaster_harness.h"

#define CODES 5u
#define STEP_HEAD 2u
#define ERROR 0x80u
#define VARIABLE 0x40u

enum { STEP_RAW, STEP_FRAME, STEP_PRINT, STEP_FINISH, STEP_SAMPLE };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(bool holds, const char *requirement)
{
    if (!holds) {
        fprintf(stderr, "%s\n", requirement);
        abort();
    }
}

static uint16_t put(uint8_t *wire, uint16_t at, uint8_t byte)
{
    wire[at++] = byte;
    if (byte == FRAME_START) {
        wire[at++] = byte;
    }
    return at;
}

static void feed_frame(harness_t *harness, const uint8_t *body, uint8_t size)
{
    static uint8_t wire[4 * 256];
    const uint8_t payload = (uint8_t)(size - 1u);
    uint8_t crc = crc8_add(crc8_add(CRC8_START, body[0]), payload);
    uint16_t at = 0;
    wire[at++] = FRAME_START;
    at = put(wire, at, body[0]);
    at = put(wire, at, payload);
    for (uint16_t i = 1; i < size; i++) {
        crc = crc8_add(crc, body[i]);
        at = put(wire, at, body[i]);
    }
    at = put(wire, at, crc);
    harness_feed(harness, wire, at);
}

/* One frame: start, undoubled status, length and data, valid checksum, and no further bytes. */
static void check_answer(const uint8_t *wire, uint16_t size)
{
    static uint8_t body[HARNESS_LINE];
    uint16_t end = 0;
    require(size >= 3 && wire[0] == FRAME_START, "no answer");
    for (uint16_t i = 1; i < size; i++) {
        if (wire[i] == FRAME_START) {
            require(i + 1u < size && wire[i + 1u] == FRAME_START, "a byte that is not doubled");
            i++;
        }
        body[end++] = wire[i];
    }
    uint8_t crc = CRC8_START;
    for (uint16_t i = 0; i + 1u < end; i++) {
        crc = crc8_add(crc, body[i]);
    }
    require(crc == body[end - 1u], "wrong checksum");
    if ((body[0] & ERROR) != 0) {
        require(end == 2, "data behind an error");
    } else if ((body[0] & VARIABLE) != 0) {
        require(end == body[1] + 3u, "wrong length");
    } else {
        require(body[0] == 0, "unknown status");
    }
}

static bool is_writable(uint16_t offset)
{
    for (uint16_t i = 0; i < fixture_table.entries; i++) {
        const tsa_entry_t *entry = &fixture_table.entry[i];
        const uint32_t at = TSA_VARIABLES_BASE + offset;
        if (entry->kind == TSA_KIND_RW && at >= entry->address && at - entry->address < entry->size) {
            return true;
        }
    }
    return false;
}

static void check_memory(const harness_t *harness)
{
    static uint8_t memory[HARNESS_LINE];
    harness_memory(harness, memory);
    require(harness_violations(harness) == 0, "the application was called against its rules");
    for (uint16_t i = 0; i < fixture_memory_size; i++) {
        require(memory[i] == fixture_memory[i] || is_writable(i), "memory that is not writable has changed");
    }
}

static uint16_t step(harness_t *harness, uint8_t code, const uint8_t *data, uint8_t size, bool *clean, uint8_t *wire)
{
    const bool whole = code == STEP_FRAME && size != 0 && data[0] != FRAME_START;
    if (whole) {
        feed_frame(harness, data, size);
    } else if (code == STEP_PRINT) {
        harness_print(harness, data, size);
    } else if (code == STEP_FINISH && size != 0) {
        harness_finish(harness, data[0], data + 1, (uint16_t)(size - 1u));
    } else if (code == STEP_SAMPLE) {
        for (uint16_t i = 0; i < size; i++) {
            harness_sample(harness, data[i] % FREEMASTER_RECORDERS);
        }
    } else if (code == STEP_RAW) {
        harness_feed(harness, data, size);
    }
    harness_poll(harness);
    const uint16_t sent = harness_take(harness, wire);
    if (whole && *clean) {
        check_answer(wire, sent);
    }
    *clean = whole || (*clean && code != STEP_RAW);
    check_memory(harness);
    return sent;
}

/* Run all steps of an input; return the number of bytes sent after the last one. */
static uint16_t run(const uint8_t *data, size_t size, uint8_t *wire)
{
    static const char *const words[ACCESS_LEVELS] = {"view", "command", "tune"};
    uint16_t sent = 0;
    harness_t *harness = size == 0 ? NULL : harness_new();
    if (harness == NULL) {
        return 0;
    }
    uint8_t hash[ACCESS_LEVELS][SHA1_SIZE];
    const uint8_t *password[ACCESS_LEVELS];
    for (uint16_t i = 0; i < ACCESS_LEVELS; i++) {
        sha1((const uint8_t *)words[i], (uint16_t)strlen(words[i]), hash[i]);
        password[i] = (data[0] >> i & 1u) != 0 ? hash[i] : NULL;
    }
    harness_set_passwords(harness, password[0], password[1], password[2]);
    size_t at = 1;
    bool clean = true;
    while (at + STEP_HEAD <= size) {
        const uint8_t code = (uint8_t)(data[at] % CODES);
        const size_t left = size - at - STEP_HEAD;
        const uint8_t length = data[at + 1] <= left ? data[at + 1] : (uint8_t)left;
        sent = step(harness, code, data + at + STEP_HEAD, length, &clean, wire);
        at += STEP_HEAD + length;
    }
    harness_free(harness);
    return sent;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static uint8_t wire[HARNESS_LINE];
    run(data, size, wire);
    return 0;
}

#ifdef FUZZ_REPLAY
int main(void)
{
    static uint8_t data[1 << 16];
    static uint8_t wire[2 + HARNESS_LINE];
    while (fread(data, 1, 2, stdin) == 2) {
        const size_t size = (size_t)data[0] | (size_t)data[1] << 8;
        require(fread(data, 1, size, stdin) == size, "an input that is cut off");
        const uint16_t sent = run(data, size, wire + 2);
        wire[0] = (uint8_t)(sent & 0xFFu);
        wire[1] = (uint8_t)(sent >> 8);
        fwrite(wire, 1, sent + 2u, stdout);
        fflush(stdout);
    }
    return 0;
}
#endif
