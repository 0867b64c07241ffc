/* transforms.h - space vectors, amplitude invariant (DRM E2..E7, k = 2/3). */
#ifndef SERVO_CONTROL_TRANSFORMS_H
#define SERVO_CONTROL_TRANSFORMS_H

#include "math/frac.h"
#include "math/trig.h"

typedef struct {
    frac16_t a;
    frac16_t b;
    frac16_t c;
} abc_t;

typedef struct {
    frac16_t alpha;
    frac16_t beta;
} ab_t;

typedef struct {
    frac16_t d;
    frac16_t q;
} dq_t;

/* E6, E7: i_alpha = (2 i_a - i_b - i_c) / 3, i_beta = (i_b - i_c) / sqrt 3. */
ab_t clarke(abc_t x);

/* Stator frame to rotor frame and back; `at` is the rotor angle (E16). */
dq_t park(ab_t x, sin_cos_t at);
ab_t park_inverse(dq_t x, sin_cos_t at);

#endif
