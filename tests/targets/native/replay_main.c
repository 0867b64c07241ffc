/* replay_main.c - feed a recording to the core, or numbers to its functions, depending on the image.
 *
 * The image is a recording (trace.h), or "SRVA", the seed and the rounds of the arithmetic as 32-bit numbers, low byte first.
 *   =VALUE        for every group of functions
 *   end VALUE     over everything
 */
#include <stddef.h>

#include "arithmetic.h"
#include "digest.h"
#include "machine.h"
#include "replay.h"
#include "text.h"

/* A machine with little memory holds one of the two, selected by the image. */
#pragma weak arithmetic_groups
#pragma weak arithmetic_digest
#pragma weak replay_recording

static uint32_t number(uint32_t at)
{
    uint32_t value = 0;
    for (uint16_t i = 4; i > 0U; i--) {
        value = value << 8 | machine_image(at + i - 1U);
    }
    return value;
}

static void arithmetic(void)
{
    uint32_t value = DIGEST_START;
    for (uint16_t group = 0; group < arithmetic_groups(); group++) {
        const uint32_t sum = arithmetic_digest(group, number(4), number(8));
        text_long("=", sum, "\n");
        value = digest_long(value, sum);
    }
    text_long("end ", value, "\n");
}

int main(void)
{
    machine_start();
    if (replay_recording != NULL && replay_recording()) {
        machine_stop(0);
    } else if (number(0) == UINT32_C(0x41565253) && arithmetic_groups != NULL) {
        arithmetic();
    } else {
        machine_print("nothing to replay\n");
        machine_stop(2);
    }
    machine_stop(0);
}
