/* The harness as a program without input: sends the frames of `fixture_script` (u8 size, bytes; 0 ends) to the server
 * and prints the answers in hexadecimal, a semicolon behind each. Prints the same on every target, whatever the size
 * of int. */
#include <stdio.h>
#include <stdlib.h>

#include "freemaster_harness.h"

#ifdef __AVR__
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

static int put_uart(char c, FILE *stream)
{
    (void)stream;
    while ((UCSR0A & _BV(UDRE0)) == 0) {
    }
    UDR0 = (uint8_t)c;
    return 0;
}

static void open_output(void)
{
    static FILE uart = FDEV_SETUP_STREAM(put_uart, NULL, _FDEV_SETUP_WRITE);
    UCSR0B = _BV(TXEN0);
    stdout = &uart;
}

static void finish(void)
{
    cli(); /* sleeping with interrupts off ends the simulation */
    sleep_cpu();
}
#else
static void open_output(void) {}
static void finish(void) {}
#endif

#define SAMPLES 7u /* of each recorder behind each frame */
#define LINE_BYTES 32u /* simulators break longer lines on their own */

extern const uint8_t fixture_script[];

int main(void)
{
    static uint8_t answer[HARNESS_LINE];
    harness_t *harness = harness_new();
    harness_print(harness, (const uint8_t *)"text + text\n", 12);
    open_output();
    printf("begin\n");
    for (const uint8_t *frame = fixture_script; harness != NULL && *frame != 0; frame += 1 + *frame) {
        harness_feed(harness, frame + 1, *frame);
        harness_poll(harness);
        for (uint16_t k = 0; k < SAMPLES; k++) {
            harness_sample(harness, 0);
            harness_sample(harness, 1);
        }
        const uint16_t size = harness_take(harness, answer);
        for (uint16_t i = 0; i < size; i++) {
            printf(i % LINE_BYTES == LINE_BYTES - 1u ? "%02X\n" : "%02X", (unsigned)answer[i]);
        }
        printf(";\n");
    }
    printf("end\n");
    finish();
    return 0;
}
