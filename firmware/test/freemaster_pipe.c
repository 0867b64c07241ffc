/* The harness as a program: chunks for the line come in on standard input, answers and memory go out. Built with
 * sanitizers, any access outside of its objects ends it.
 *
 *   in   u16 size, bytes             out   u16 size, bytes sent, memory, u16 violations      (little endian)
 *   in   u16 FFFF                    a fresh server, nothing goes out
 */
#include <stdio.h>

#include "freemaster_harness.h"

#define FRESH 0xFFFFu

static bool get_u16(uint16_t *value)
{
    const int low = getchar();
    const int high = getchar();
    *value = (uint16_t)((unsigned)low | (unsigned)high << 8);
    return high != EOF;
}

static void put_u16(uint16_t value)
{
    putchar(value & 0xFF);
    putchar(value >> 8);
}

int main(void)
{
    static uint8_t buffer[HARNESS_LINE];
    harness_t *harness = harness_new();
    uint16_t size;
    while (harness != NULL && get_u16(&size)) {
        if (size == FRESH) {
            harness_free(harness);
            harness = harness_new();
            continue;
        }
        if (size > HARNESS_LINE || fread(buffer, 1, size, stdin) != size) {
            break;
        }
        /* Byte by byte, so that every frame in the chunk is answered; the loops go on meanwhile. */
        for (uint16_t i = 0; i < size; i++) {
            harness_feed(harness, buffer + i, 1);
            harness_poll(harness);
            harness_sample(harness, 0);
            harness_sample(harness, 1);
        }
        size = harness_take(harness, buffer);
        put_u16(size);
        fwrite(buffer, 1, size, stdout);
        harness_memory(harness, buffer);
        fwrite(buffer, 1, fixture_memory_size, stdout);
        put_u16(harness_violations(harness));
        fflush(stdout);
    }
    harness_free(harness);
    return 0;
}
