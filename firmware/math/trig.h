/* trig.h - sine, cosine and square root of fractions. */
#ifndef SERVO_MATH_TRIG_H
#define SERVO_MATH_TRIG_H

#include "math/frac.h"

typedef struct {
    frac16_t sin;
    frac16_t cos;
} sin_cos_t;

/* Sine and cosine of pi x angle; at most 1.001 LSB off. */
sin_cos_t sin_cos(frac16_t angle);

/* Square root of a fraction in [0, 1), rounded down; 0 for negative numbers. */
frac16_t f16_sqrt(frac32_t x);

#endif
