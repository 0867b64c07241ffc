/* frac.h - Q1.15 and Q1.31 fractions with the rounding and saturation of the DSC's arithmetic unit.
 *
 * frac16_t is raw / 2^15, frac32_t is raw / 2^31; range [-1, 1). Independent of the width of `int`: operands are
 * widened before a product, and negative numbers are shifted right with asr32 and asr64.
 */
#ifndef SERVO_MATH_FRAC_H
#define SERVO_MATH_FRAC_H

#include <stdbool.h>
#include <stdint.h>

#include "math/saturate.h"

typedef int16_t frac16_t;
typedef int32_t frac32_t;

/* Gain raw / 2^24, range [-128, 128). */
typedef int32_t gain_t;
#define GAIN_BITS 24

#define FRAC16_MAX INT16_MAX
#define FRAC16_MIN INT16_MIN
#define FRAC32_MAX INT32_MAX
#define FRAC32_MIN INT32_MIN

static inline int64_t asr64(int64_t x, unsigned n) { return (x < 0) ? ~(~x >> n) : (x >> n); }

/* Saturate to 32 bits: no overflow if the upper half is the sign extension of the lower half. In this form compilers
 * use 32-bit operations. */
static inline int32_t sat32(int64_t x)
{
    const uint32_t high = (uint32_t)((uint64_t)x >> 32);
    uint32_t low = (uint32_t)((uint64_t)x & UINT32_C(0xFFFFFFFF));
    if (high + (low >> 31) != 0U) {
        low = UINT32_C(0x7FFFFFFF) + (high >> 31);
    }
    return (int32_t)low;
}

/* Limit to [-limit, limit]; limit >= 0. */
static inline frac16_t f16_limit(int32_t x, frac16_t limit)
{
    if (x > limit) {
        return limit;
    }
    if (x < -limit) {
        return (frac16_t)-limit;
    }
    return (frac16_t)x;
}

static inline frac32_t f32_clip(frac32_t x, frac32_t limit)
{
    if (x > limit) {
        return limit;
    }
    return (x < -limit) ? -limit : x;
}

static inline frac32_t f32_limit(int64_t x, frac32_t limit) { return f32_clip(sat32(x), limit); }

static inline frac16_t f16_add(frac16_t a, frac16_t b) { return sat16((int32_t)a + b); }
static inline frac16_t f16_sub(frac16_t a, frac16_t b) { return sat16((int32_t)a - b); }
static inline frac16_t f16_neg(frac16_t a) { return sat16(-(int32_t)a); }
static inline frac16_t f16_abs(frac16_t a) { return (a < 0) ? f16_neg(a) : a; }

static inline frac32_t f32_add(frac32_t a, frac32_t b) { return sat32((int64_t)a + b); }
static inline frac32_t f32_sub(frac32_t a, frac32_t b) { return sat32((int64_t)a - b); }
static inline frac32_t f32_abs(frac32_t a)
{
    if (a >= 0) {
        return a;
    }
    return (a == FRAC32_MIN) ? FRAC32_MAX : -a;
}

/* Sums and differences of angles in [-pi, pi), modulo 2 pi. */
static inline frac16_t f16_add_wrap(frac16_t a, frac16_t b) { return (frac16_t)(uint16_t)((uint16_t)a + (uint16_t)b); }
static inline frac16_t f16_sub_wrap(frac16_t a, frac16_t b) { return (frac16_t)(uint16_t)((uint16_t)a - (uint16_t)b); }
static inline int32_t i32_sub_wrap(int32_t a, int32_t b) { return (int32_t)((uint32_t)a - (uint32_t)b); }
static inline int32_t i32_add_wrap(int32_t a, int32_t b) { return (int32_t)((uint32_t)a + (uint32_t)b); }

/* Absolute value; a != INT32_MIN. */
static inline int32_t i32_abs(int32_t a) { return (a < 0) ? -a : a; }

/* Rounded product; (-1) x (-1) saturates (DSC: MPYR with saturation). */
static inline frac16_t f16_mul(frac16_t a, frac16_t b) { return sat16_asr((int32_t)a * b + INT32_C(0x4000), 15); }

/* Full product Q1.15 x Q1.15 -> Q1.31; (-1) x (-1) saturates (DSC: MPY). */
static inline frac32_t f32_mul16(frac16_t a, frac16_t b)
{
    const int32_t product = (int32_t)a * b;
    return (product == INT32_C(0x40000000)) ? FRAC32_MAX : product * 2;
}

/* Conversion to Q1.31, exact, and to Q1.15, rounded. */
static inline frac32_t f32_from_f16(frac16_t a) { return (frac32_t)a * INT32_C(65536); }
static inline frac16_t f16_from_f32(frac32_t a) { return sat16_asr(asr32(a, 15) + 1, 1); }

/* Gain x fraction, rounded and saturated. */
static inline frac32_t f32_gain(frac32_t x, gain_t gain)
{
    return sat32(asr64((int64_t)x * gain + (INT64_C(1) << (GAIN_BITS - 1)), GAIN_BITS));
}

/* Gain x Q1.15 fraction in a 32-bit word, rounded down; the result is limited to [-2, 2). */
static inline int32_t i32_gain(int32_t x, gain_t gain)
{
    /* +2^-16 of the last bit: rounding of the product at 15 more fraction bits, then rounded down */
    const int32_t product = (int32_t)asr64((int64_t)x * gain + INT32_C(256), GAIN_BITS);
    if (product > INT32_C(0xFFFF)) {
        return INT32_C(0xFFFF);
    }
    return (product < -INT32_C(0x10000)) ? -INT32_C(0x10000) : product;
}

#endif
