#include "math/divide.h"

/* Long division with one digit of 32 bits and two of 16: the remainder and the next digit together fit 32 bits. */
int64_t i64_over_u16(int64_t x, uint16_t divisor)
{
    const uint64_t magnitude = (uint64_t)((x < 0) ? -x : x);
    const uint32_t high = (uint32_t)(magnitude >> 32);
    const uint32_t low = (uint32_t)(magnitude & UINT32_C(0xFFFFFFFF));
    const uint32_t middle = high % divisor << 16 | low >> 16;
    const uint32_t last = middle % divisor << 16 | (low & UINT32_C(0xFFFF));
    const uint64_t quotient = (uint64_t)(high / divisor) << 32 | (middle / divisor << 16 | last / divisor);
    return (x < 0) ? -(int64_t)quotient : (int64_t)quotient;
}
