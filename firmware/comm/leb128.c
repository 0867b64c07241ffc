#include "comm/leb128.h"

#include <stdbool.h>

#define GROUP 7u
#define MORE 0x80u
#define SIGN 0x40u

/* Decoding of both signed and unsigned numbers; `fill` extends the sign of the last group. */
static uint16_t get(const uint8_t *data, uint16_t size, bool fill, uint32_t *value)
{
    uint32_t bits = 0;
    unsigned shift = 0; /* limited to 35: redundant padding bytes may be longer than the counter's range */
    for (uint16_t at = 0; at < size; at++) {
        if (shift < 32u) {
            bits |= (uint32_t)(data[at] & 0x7Fu) << shift;
            shift += GROUP;
        }
        if ((data[at] & MORE) == 0) {
            if (fill && (data[at] & SIGN) != 0 && shift < 32u) {
                bits |= UINT32_MAX << shift;
            }
            *value = bits;
            return (uint16_t)(at + 1u);
        }
    }
    return 0;
}

uint16_t leb128_get_unsigned(const uint8_t *data, uint16_t size, uint32_t *value)
{
    return get(data, size, false, value);
}

uint16_t leb128_get_signed(const uint8_t *data, uint16_t size, int32_t *value)
{
    uint32_t bits = 0;
    const uint16_t used = get(data, size, true, &bits);
    if (used != 0) {
        /* Two's complement without the implementation-defined conversion of large unsigned numbers. */
        *value = bits <= (uint32_t)INT32_MAX ? (int32_t)bits : -(int32_t)(UINT32_MAX - bits) - 1;
    }
    return used;
}

uint16_t leb128_put_unsigned(uint8_t data[LEB128_SIZE_MAX], uint32_t value)
{
    uint16_t size = 0;
    while (value > 0x7Fu) {
        data[size++] = (uint8_t)((value & 0x7Fu) | MORE);
        value >>= GROUP;
    }
    data[size++] = (uint8_t)value;
    return size;
}
