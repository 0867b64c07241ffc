#include "control/transforms.h"

/* Constants with 30 fraction bits: the error stays below the rounding of the result. */
#define ONE_THIRD_Q30 INT32_C(357913941)
#define ONE_BY_SQRT3_Q30 INT32_C(619925131)
#define HALF_Q30 (INT32_C(1) << 29)

ab_t clarke(abc_t x)
{
    const int32_t sum = 2 * (int32_t)x.a - x.b - x.c;
    const int32_t difference = (int32_t)x.b - x.c;
    const ab_t result = {
        sat16((int32_t)asr64((int64_t)sum * ONE_THIRD_Q30 + HALF_Q30, 30)),
        sat16((int32_t)asr64((int64_t)difference * ONE_BY_SQRT3_Q30 + HALF_Q30, 30)),
    };
    return result;
}

/* One component of a rotation: a c + b s, rounded and saturated once. c and s lie on the unit circle, so the sum stays
 * below sqrt(2) 2^30 and needs no more than 32 bits. */
static frac16_t rotate(frac16_t a, frac16_t c, frac16_t b, frac16_t s)
{
    return sat16(asr32((int32_t)a * c + (int32_t)b * s + INT32_C(0x4000), 15));
}

dq_t park(ab_t x, sin_cos_t at)
{
    const dq_t result = {
        rotate(x.alpha, at.cos, x.beta, at.sin),
        rotate(x.beta, at.cos, x.alpha, (frac16_t)-at.sin),
    };
    return result;
}

ab_t park_inverse(dq_t x, sin_cos_t at)
{
    const ab_t result = {
        rotate(x.d, at.cos, x.q, (frac16_t)-at.sin),
        rotate(x.q, at.cos, x.d, at.sin),
    };
    return result;
}
