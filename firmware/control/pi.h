/* pi.h - PI controller with back-calculation anti-windup (DRM 2.5.2, E34..E37). */
#ifndef SERVO_CONTROL_PI_H
#define SERVO_CONTROL_PI_H

#include "math/frac.h"

typedef struct {
    gain_t kp; /* Kp */
    gain_t ki; /* Kp Ki Ts */
    gain_t kc; /* Kc, between 0 (no anti-windup) and 1 */
} pi_gains_t;

typedef struct {
    frac32_t integral; /* u_i(k-1) */
    frac32_t excess;   /* u_out(k-1) - u_presat(k-1) */
} pi_state_t;

void pi_reset(pi_state_t *state, frac32_t integral);

/* One sample: error e(k), feed-forward added before the limit, result within +-limit. The anti-windup term goes into
 * the integrator, as DRM 2.5.2 says in words; E36 as printed would leave the integrator winding up. */
frac32_t pi_step(pi_state_t *state, const pi_gains_t *gains, frac32_t error, frac32_t feed_forward, frac32_t limit);

#endif
