/* friction.h - feed-forward current for Coulomb friction (with a smooth sign function) and viscous friction.
 *
 * Extension of the reference design. Computed from the speed set-point. The measured speed is unsuitable: it is 0
 * before the start, and an over-estimated friction would be positive feedback.
 */
#ifndef SERVO_CONTROL_FRICTION_H
#define SERVO_CONTROL_FRICTION_H

#include "math/frac.h"

typedef struct {
    frac32_t coulomb; /* current for Coulomb friction, Q1.31 of full-scale current */
    gain_t viscous;   /* current for viscous friction / speed, of full scales */
    frac32_t smooth;  /* speed above which the sign function is +-1; positive, Q1.31 of full-scale speed */
    int32_t slope;    /* 1 / smooth, 16 fraction bits */
} friction_config_t;

/* i = coulomb s(speed / smooth) + viscous speed, where s(x) = x (3 - x^2) / 2 for |x| <= 1, sign(x) otherwise: s is
 * continuously differentiable. */
frac32_t friction_current(const friction_config_t *config, frac32_t speed);

#endif
