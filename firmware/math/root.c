#include "math/root.h"

/* Root of a number of 2^30 or more, rounded down. The linear estimate has an error of at most 7 %; each of two Heron
 * steps squares and halves it, and the result is the root or one above it. */
static uint32_t upper_half(uint32_t high)
{
    uint32_t root = (high >> 17) + (high >> 18) + UINT32_C(20800);
    root = (root + high / root) >> 1;
    root = (root + high / root) >> 1;
    return (root > UINT32_C(0xFFFF) || root * root > high) ? root - 1U : root;
}

uint32_t u64_sqrt(uint64_t x)
{
    uint32_t high = (uint32_t)(x >> 32);
    uint32_t low = (uint32_t)(x & UINT32_C(0xFFFFFFFF));
    uint16_t shift = 0; /* shift of the root: half of the shift of the number */
    if (high == 0U) {
        high = low;
        low = 0;
        shift = 16;
    }
    if (high == 0U) {
        return 0;
    }
    if (high < UINT32_C(1) << 16) {
        high = high << 16 | low >> 16;
        low <<= 16;
        shift = (uint16_t)(shift + 8U);
    }
    if (high < UINT32_C(1) << 24) {
        high = high << 8 | low >> 24;
        low <<= 8;
        shift = (uint16_t)(shift + 4U);
    }
    if (high < UINT32_C(1) << 28) {
        high = high << 4 | low >> 28;
        low <<= 4;
        shift = (uint16_t)(shift + 2U);
    }
    if (high < UINT32_C(1) << 30) {
        high = high << 2 | low >> 30;
        low <<= 2;
        shift = (uint16_t)(shift + 1U);
    }
    const uint32_t upper = upper_half(high);
    /* Solves (upper 2^16 + lower)^2 = x without the term lower^2, so the result may be one too large. */
    uint32_t lower = ((high - upper * upper) << 15 | low >> 17) / upper;
    if (lower > UINT32_C(0xFFFF)) {
        lower = UINT32_C(0xFFFF);
    }
    const uint32_t root = upper << 16 | lower;
    const bool above = (uint64_t)root * root > ((uint64_t)high << 32 | low);
    return (above ? root - 1U : root) >> shift;
}
