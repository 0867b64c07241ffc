#include "math/divide.h"

/* Digit by digit of 16 bits, as on paper. */
int64_t i64_over_u16(int64_t x, uint16_t divisor)
{
    const uint64_t magnitude = (uint64_t)((x < 0) ? -x : x);
    uint64_t quotient = 0;
    uint32_t rest = 0;
    for (uint16_t shift = 64; shift != 0U;) {
        shift = (uint16_t)(shift - 16U);
        rest = rest << 16 | (uint32_t)((magnitude >> shift) & UINT32_C(0xFFFF));
        quotient = quotient << 16 | rest / divisor;
        rest %= divisor;
    }
    return (x < 0) ? -(int64_t)quotient : (int64_t)quotient;
}
