/* frac.h - Q1.15 and Q1.31 fractions with the rounding and saturation of the DSC's arithmetic unit.
 *
 * frac16_t is the fraction raw / 2^15, frac32_t is raw / 2^31; both cover [-1, 1). Nothing here depends on the width of
 * `int`: products are widened before they are formed, and right shifts of negative numbers go through asr16/32/64.
 */
#ifndef SERVO_MATH_FRAC_H
#define SERVO_MATH_FRAC_H

#include <stdbool.h>
#include <stdint.h>

#include "math/saturate.h"

typedef int16_t frac16_t;
typedef int32_t frac32_t;

/* A gain between -128 and 128 with a fixed scale: raw / 2^24. */
typedef int32_t gain_t;
#define GAIN_BITS 24

#define FRAC16_MAX INT16_MAX
#define FRAC16_MIN INT16_MIN
#define FRAC32_MAX INT32_MAX
#define FRAC32_MIN INT32_MIN

static inline int64_t asr64(int64_t x, unsigned n) { return (x < 0) ? ~(~x >> n) : (x >> n); }

/* A number fits when its upper half is the sign of its lower one. Written so, compilers do not carry on with 64 bits. */
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

/* Angles wrap: the sum of two angles in [-pi, pi) is taken modulo 2 pi. */
static inline frac16_t f16_add_wrap(frac16_t a, frac16_t b) { return (frac16_t)(uint16_t)((uint16_t)a + (uint16_t)b); }
static inline frac16_t f16_sub_wrap(frac16_t a, frac16_t b) { return (frac16_t)(uint16_t)((uint16_t)a - (uint16_t)b); }
static inline int32_t i32_sub_wrap(int32_t a, int32_t b) { return (int32_t)((uint32_t)a - (uint32_t)b); }
static inline int32_t i32_add_wrap(int32_t a, int32_t b) { return (int32_t)((uint32_t)a + (uint32_t)b); }

/* Of what is far from the ends of its type. */
static inline int32_t i32_abs(int32_t a) { return (a < 0) ? -a : a; }

/* Rounded product; (-1) x (-1) saturates (DSC: MPYR with saturation). */
static inline frac16_t f16_mul(frac16_t a, frac16_t b) { return sat16_asr((int32_t)a * b + INT32_C(0x4000), 15); }

/* Full product Q1.15 x Q1.15 -> Q1.31; (-1) x (-1) saturates (DSC: MPY). */
static inline frac32_t f32_mul16(frac16_t a, frac16_t b)
{
    const int32_t product = (int32_t)a * b;
    return (product == INT32_C(0x40000000)) ? FRAC32_MAX : product * 2;
}

/* Widen without loss, and round back. */
static inline frac32_t f32_from_f16(frac16_t a) { return (frac32_t)a * INT32_C(65536); }
static inline frac16_t f16_from_f32(frac32_t a) { return sat16_asr(asr32(a, 15) + 1, 1); }

/* gain x fraction, rounded, saturated. */
static inline frac32_t f32_gain(frac32_t x, gain_t gain)
{
    return sat32(asr64((int64_t)x * gain + (INT64_C(1) << (GAIN_BITS - 1)), GAIN_BITS));
}

/* The same for fractions of 15 bits, which may be a little beyond 1; rounded down. */
static inline int32_t i32_gain(int32_t x, gain_t gain)
{
    const int32_t product =
        (int32_t)asr64((int64_t)x * gain + INT32_C(256), GAIN_BITS); /* rounded 15 bits farther down */
    if (product > INT32_C(0xFFFF)) {
        return INT32_C(0xFFFF);
    }
    return (product < -INT32_C(0x10000)) ? -INT32_C(0x10000) : product;
}

#endif
