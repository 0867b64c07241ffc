/* transforms.h - space vectors, amplitude invariant (DRM E2..E7, k = 2/3). */
#ifndef SERVO_CONTROL_TRANSFORMS_H
#define SERVO_CONTROL_TRANSFORMS_H

#include "math/frac.h"
#include "math/trig.h"

/* Q1.15 fractions in 32-bit words: intermediate results of sums and products. */
typedef struct {
    int32_t a; /* phase A, Q1.15 of full scale */
    int32_t b; /* phase B, Q1.15 of full scale */
    int32_t c; /* phase C, Q1.15 of full scale */
} abc_t;

typedef struct {
    frac16_t alpha; /* alpha component, Q1.15 of full scale */
    frac16_t beta; /* beta component, Q1.15 of full scale */
} ab_t;

typedef struct {
    frac16_t d; /* d component, Q1.15 of full scale */
    frac16_t q; /* q component, Q1.15 of full scale */
} dq_t;

/* 1/3 with 32 fraction bits, 1/sqrt 3 with 31: all results are rounded to nearest. */
#define CLARKE_ONE_THIRD_Q32 INT32_C(1431655765)
#define CLARKE_ONE_BY_SQRT3_Q31 INT32_C(1239850263)

/* x c / 2^32, rounded. */
static inline int32_t clarke_scale(int32_t x, int32_t c)
{
    return (int32_t)asr64((int64_t)x * c + (INT64_C(1) << 31), 32);
}

/* E6, E7: i_alpha = (2 i_a - i_b - i_c) / 3, i_beta = (i_b - i_c) / sqrt 3. */
static inline ab_t clarke(abc_t x)
{
    const ab_t result = {
        sat16(clarke_scale(2 * x.a - x.b - x.c, CLARKE_ONE_THIRD_Q32)),
        sat16(clarke_scale(2 * (x.b - x.c), CLARKE_ONE_BY_SQRT3_Q31)),
    };
    return result;
}

/* Round and saturate a sum of two products with sine and cosine; it is below sqrt(2) 2^30, so 32 bits are
 * sufficient. */
static inline frac16_t rotated(int32_t sum) { return sat16_asr(sum + INT32_C(0x4000), 15); }

/* Inverse Clarke transformation; phase C is the negative sum of A and B. */
static inline abc_t clarke_inverse(ab_t x)
{
    const int32_t half = asr32((int32_t)x.beta * INT32_C(28378) + INT32_C(0x4000), 15); /* sqrt 3 / 2 beta */
    const int32_t b = half - asr32(x.alpha, 1);
    const abc_t result = {x.alpha, b, -x.alpha - b};
    return result;
}

/* Approximate length of a vector; error 0 .. +12 %. */
static inline int32_t length_about(int32_t x, int32_t y)
{
    const int32_t a = i32_abs(x);
    const int32_t b = i32_abs(y);
    return (a > b) ? a + b / 2 : b + a / 2;
}

/* Park transformation and its inverse; `at`: sine and cosine of the rotor angle (E16).
 *   d = alpha cos + beta sin,  q = beta cos - alpha sin. */
static inline dq_t park(ab_t x, sin_cos_t at)
{
    const dq_t result = {
        rotated((int32_t)x.alpha * at.cos + (int32_t)x.beta * at.sin),
        rotated((int32_t)x.beta * at.cos - (int32_t)x.alpha * at.sin),
    };
    return result;
}

static inline ab_t park_inverse(dq_t x, sin_cos_t at)
{
    const ab_t result = {
        rotated((int32_t)x.d * at.cos - (int32_t)x.q * at.sin),
        rotated((int32_t)x.q * at.cos + (int32_t)x.d * at.sin),
    };
    return result;
}

#endif
