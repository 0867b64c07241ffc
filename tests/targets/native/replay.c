/* replay.c - feed a recording to the core and print check values of all outputs.
 *
 *   =VALUE        after each interval of the header
 *   ?PERIOD ...   each call of the periods to be printed: kind, axis, words not read, words missing, words out
 *   !FIELD VALUE  after such a call: scalars of the snapshot by their index in the table of variables
 *   end VALUE     over everything
 */
#include <stddef.h>

#include "app/variables.h"
#include "digest.h"
#include "machine.h"
#include "replay.h"
#include "replay_hal.h"
#include "text.h"

static servo_t servo;
static hal_t hal;
static trace_reader_t reader;
static trace_call_t call;
static digest_t digest;

static void print_call(uint32_t period)
{
    text_long("?", period, " ");
    text_word("", (uint16_t)call.call, " ");
    text_word("", call.axis, " ");
    text_word("", hal.remaining, " ");
    text_word("", hal.missing, "");
    for (uint16_t i = 0; i < hal.out.size && i < EXCHANGE_OUT_MAX; i++) {
        text_word(" ", hal.out.word[i], "");
    }
    machine_print("\n");
}

static void print_snapshot(void)
{
    for (uint16_t i = 0; i < servo_variables.entries; i++) {
        uint32_t value;
        if (digest_snapshot_field(&servo, i, &value)) {
            text_word("!", i, " ");
            text_long("", value, "\n");
        }
    }
}

bool replay_recording(void)
{
    if (!trace_reader_open(&reader, machine_image)) {
        return false;
    }
    if (!digest_init(&digest)) {
        machine_print("too many scalars in the snapshot\n");
        machine_stop(2);
    }
    replay_power_on(&hal);
    while (trace_reader_next(&reader, &call)) {
        const uint32_t period = digest.periods;
        replay_load(&hal, &call);
        if (!replay_call(&servo, &hal, &call)) {
            break;
        }
        const bool fresh = servo.snapshot.tick != digest.tick;
        digest_call(&digest, call.call, call.axis, hal.remaining, hal.missing, &hal.out, &servo);
        if (period >= reader.print_first && period <= reader.print_last) {
            print_call(period);
            if (fresh) {
                print_snapshot();
            }
        }
        if (digest.periods != period && digest.periods % reader.check_every == 0U) {
            text_long("=", digest.value, "\n");
        }
    }
    text_long("end ", digest.value, "\n");
    return true;
}
