#include "math/crc32.h"

#define POLYNOMIAL UINT32_C(0xEDB88320)

/* Bit by bit: a table would occupy RAM, and only the background computes checksums. */
uint32_t crc32_add(uint32_t crc, uint32_t value, uint16_t size)
{
    for (uint16_t k = 0; k < 8U * size; k++) {
        const uint32_t carry = (crc ^ value) & 1U;
        crc >>= 1;
        crc ^= (carry != 0U) ? POLYNOMIAL : 0U;
        value >>= 1;
    }
    return crc;
}
