/* trig.h - sine, cosine, angle and square root of fractions. */
#ifndef SERVO_MATH_TRIG_H
#define SERVO_MATH_TRIG_H

#include "math/frac.h"

/* Fractions with 15 bits in a word, ready to be multiplied. */
typedef struct {
    int32_t sin; /* Q1.15 */
    int32_t cos; /* Q1.15 */
} sin_cos_t;

/* sin(pi/2 i/256) in Q1.15, one quarter wave and its end point. Linear interpolation between neighbours is off by at
 * most (pi/512)^2 / 8 = 4.7e-6, a seventh of one LSB. */
#define TRIG_QUARTER_STEPS 256
#define TRIG_REST_BITS 6
extern const int16_t trig_quarter_wave[TRIG_QUARTER_STEPS + 1];

/* `part` of the way from one entry to the next. */
static inline int32_t trig_between(const int16_t *entry, int32_t part)
{
    const int32_t low = entry[0];
    const int32_t rise = entry[1] - low;
    return asr32(low * (INT32_C(1) << TRIG_REST_BITS) + rise * part + (INT32_C(1) << (TRIG_REST_BITS - 1)),
                 TRIG_REST_BITS);
}

/* Sine and cosine of pi x angle; at most 1.001 LSB off. */
static inline sin_cos_t sin_cos(frac16_t angle)
{
    const uint16_t phase = (uint16_t)angle; /* 0..0xFFFF is 0..2 pi */
    const uint16_t step = (uint16_t)((phase >> TRIG_REST_BITS) & (TRIG_QUARTER_STEPS - 1U));
    const int32_t part = (int32_t)(phase & ((1U << TRIG_REST_BITS) - 1U));
    /* Within a quarter the cosine is the sine read backwards. */
    const int32_t up = trig_between(&trig_quarter_wave[step], part);
    const int32_t down =
        trig_between(&trig_quarter_wave[TRIG_QUARTER_STEPS - 1U - step], (INT32_C(1) << TRIG_REST_BITS) - part);

    sin_cos_t result = {up, down};
    if ((phase & 0x4000U) != 0U) {
        result = (sin_cos_t){down, -up};
    }
    if ((phase & 0x8000U) != 0U) {
        result = (sin_cos_t){-result.sin, -result.cos};
    }
    return result;
}

/* The same as a call, where code counts for more than time. */
sin_cos_t sin_cos_of(frac16_t angle);

/* Angle of the vector (x, y), 2^16 is a turn; at most 0.25 degrees off. */
frac16_t f16_angle(frac16_t x, frac16_t y);

/* Square root of a fraction in [0, 1), rounded down; 0 for negative numbers. */
frac16_t f16_sqrt(frac32_t x);

#endif
