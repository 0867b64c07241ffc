/* trig.h - sine, cosine, angle and square root of fractions. */
#ifndef SERVO_MATH_TRIG_H
#define SERVO_MATH_TRIG_H

#include "math/frac.h"

/* Q1.15 fractions in 32-bit words, for products. */
typedef struct {
    int32_t sin; /* sine, Q1.15 */
    int32_t cos; /* cosine, Q1.15 */
} sin_cos_t;

/* sin(pi/2 i/256) in Q1.15, one quarter wave with its end point. Largest error of the linear interpolation:
 * (pi/512)^2 / 8 = 4.7e-6, a seventh of one LSB. */
#define TRIG_QUARTER_STEPS 256
#define TRIG_REST_BITS 6
extern const int16_t trig_quarter_wave[TRIG_QUARTER_STEPS + 1];

/* Linear interpolation between two entries; `part` has TRIG_REST_BITS fraction bits. */
static inline int32_t trig_between(const int16_t *entry, int32_t part)
{
    const int32_t low = entry[0];
    const int32_t rise = entry[1] - low;
    return asr32(low * (INT32_C(1) << TRIG_REST_BITS) + rise * part + (INT32_C(1) << (TRIG_REST_BITS - 1)),
                 TRIG_REST_BITS);
}

/* Sine and cosine of pi x angle; error at most 1.001 LSB. */
static inline sin_cos_t sin_cos(frac16_t angle)
{
    const uint16_t phase = (uint16_t)angle; /* 0..0xFFFF is 0..2 pi */
    const uint16_t step = (uint16_t)((phase >> TRIG_REST_BITS) & (TRIG_QUARTER_STEPS - 1U));
    const int32_t part = (int32_t)(phase & ((1U << TRIG_REST_BITS) - 1U));
    /* cos(x) = sin(pi/2 - x) */
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

/* Sine of pi x angle in Q1.15, as that of sin_cos. */
static inline int32_t f16_sin(frac16_t angle)
{
    const uint16_t phase = (uint16_t)angle;
    const uint16_t step = (uint16_t)((phase >> TRIG_REST_BITS) & (TRIG_QUARTER_STEPS - 1U));
    const int32_t part = (int32_t)(phase & ((1U << TRIG_REST_BITS) - 1U));
    const int32_t sine = ((phase & 0x4000U) == 0U) ? trig_between(&trig_quarter_wave[step], part)
                                                   : trig_between(&trig_quarter_wave[TRIG_QUARTER_STEPS - 1U - step],
                                                                  (INT32_C(1) << TRIG_REST_BITS) - part);
    return ((phase & 0x8000U) == 0U) ? sine : -sine;
}

/* sin_cos as a function call: less code, more time. */
sin_cos_t sin_cos_of(frac16_t angle);

/* Angle of the vector (x, y), 2^16 is one turn; error at most 0.25 degrees. */
frac16_t f16_angle(frac16_t x, frac16_t y);

/* Square root of a fraction in [0, 1), rounded down; 0 for negative numbers. */
frac16_t f16_sqrt(frac32_t x);

#endif
