#include "comm/crc8.h"

/* Four bits per step: a table of 16 bytes instead of 256, for twice the number of steps. */
static uint8_t add_nibble(uint8_t crc)
{
    static const uint8_t remainder[16] = {0x00, 0x07, 0x0E, 0x09, 0x1C, 0x1B, 0x12, 0x15,
                                          0x38, 0x3F, 0x36, 0x31, 0x24, 0x23, 0x2A, 0x2D};
    return (uint8_t)((unsigned)crc << 4 ^ remainder[crc >> 4]);
}

uint8_t crc8_add(uint8_t crc, uint8_t byte) { return add_nibble(add_nibble((uint8_t)(crc ^ byte))); }
