/* units.c - prices of the PRICES charges of the firmware: 32-bit numbers, low byte first, after 3 bytes. */
#include <stdbool.h>

#include "machine.h"

unsigned core_units;
unsigned core_price[PRICES];

uint32_t machine_clock(void)
{
    static bool known;
    for (uint32_t i = 0; !known && i < 4U * PRICES; i++) {
        core_price[i / 4U] |= (unsigned)machine_image(3U + i) << (8U * (i % 4U));
    }
    known = true;
    return core_units;
}
