/* friction.h - the current that friction takes: Coulomb with a smooth sign, and viscous.
 *
 * Beyond the reference design. Fed forward from the speed set-point, not from the measured speed: that could not start a
 * shaft, and too large a nominal value would close a loop with positive feedback.
 */
#ifndef SERVO_CONTROL_FRICTION_H
#define SERVO_CONTROL_FRICTION_H

#include "math/frac.h"

typedef struct {
    frac32_t coulomb; /* current against Coulomb friction */
    gain_t viscous;   /* speed -> current */
    frac32_t smooth;  /* speed from which on the sign is whole, more than 0 */
    int32_t slope;    /* 1 / smooth, 16 fraction bits */
} friction_config_t;

/* i = coulomb s(speed / smooth) + viscous speed, where s(x) = x (3 - x^2) / 2 within -1..1 and the sign outside: no step,
 * and no corner, that the current would have to follow. */
frac32_t friction_current(const friction_config_t *config, frac32_t speed);

#endif
