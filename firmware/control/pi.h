/* pi.h - PI controller with back-calculation anti-windup (DRM 2.5.2, E34..E37).
 *
 *   u_presat(k) = Kp e(k) + u_i(k)
 *   u_out(k)    = limit(u_presat(k), -u_max, u_max)
 *   u_i(k)      = u_i(k-1) + Kp Ki Ts e(k) + Kc (u_out(k-1) - u_presat(k-1))
 */
#ifndef SERVO_CONTROL_PI_H
#define SERVO_CONTROL_PI_H

#include "math/frac.h"

typedef struct {
    gain_t kp; /* proportional gain Kp */
    gain_t ki; /* integral gain Kp Ki Ts */
    gain_t kc; /* anti-windup gain Kc: 0 (off) .. 1 */
} pi_gains_t;

/* Sum of products fraction x gain before rounding: 55 fraction bits, range +-256. The gains of one sum must add up
 * to less than 255. */
typedef int64_t pi_sum_t;
#define PI_SUM_BITS (31 + GAIN_BITS)

typedef struct {
    pi_sum_t integral; /* u_i(k-1), within +-1, 55 fraction bits */
    frac32_t excess;   /* u_out(k-1) - u_presat(k-1): anti-windup feedback, Q1.31 */
} pi_state_t;

void pi_reset(pi_state_t *state, frac32_t integral);

/* Convert a fraction to a sum. */
static inline pi_sum_t pi_sum_of(frac32_t x) { return (pi_sum_t)x * (INT32_C(1) << GAIN_BITS); }

/* sum + x gain */
static inline pi_sum_t pi_sum_add(pi_sum_t sum, frac32_t x, gain_t gain) { return sum + (int64_t)x * gain; }

/* Saturate to +-1. Usually not needed; the upper half of the sum is sufficient for the test. */
static inline pi_sum_t pi_sum_saturated(pi_sum_t sum)
{
    const int32_t upper = (int32_t)asr64(sum, 32);
    const int32_t one = INT32_C(1) << (PI_SUM_BITS - 32);
    if (upper < one && upper >= -one) {
        return sum;
    }
    return pi_sum_of((upper < 0) ? FRAC32_MIN : FRAC32_MAX);
}

/* u_i(k-1), rounded down. */
static inline frac32_t pi_integral(const pi_state_t *state) { return (frac32_t)asr64(state->integral, GAIN_BITS); }

/* Integrator, E35 and E36: u_i. Back-calculation anti-windup acts on the integrator, as the text of DRM 2.5.2
 * describes; E36 as printed does not prevent wind-up. */
static inline void pi_integrate(pi_state_t *state, const pi_gains_t *gains, frac32_t error)
{
    const pi_sum_t integral = pi_sum_add(state->integral, error, gains->ki);
    state->integral = pi_sum_saturated(pi_sum_add(integral, state->excess, gains->kc));
}

/* pi_integrate, then u_p + u_i. Feed-forward may be added to the sum before pi_limit. */
static inline pi_sum_t pi_sum(pi_state_t *state, const pi_gains_t *gains, frac32_t error)
{
    pi_integrate(state, gains, error);
    return pi_sum_add(state->integral, error, gains->kp);
}

/* u_i for a bumpless change of gains: equal sum at equal error; not saturated. */
static inline pi_sum_t pi_retuned(const pi_state_t *state, const pi_gains_t *before, const pi_gains_t *gains,
                                  frac32_t error)
{
    return pi_sum_add(state->integral, error, before->kp - gains->kp);
}

/* Output limit, E37: u_out within +-limit. */
static inline frac32_t pi_limit(pi_state_t *state, pi_sum_t sum, frac32_t limit)
{
    const int64_t u_presat = asr64(sum + (INT32_C(1) << (GAIN_BITS - 1)), GAIN_BITS);
    const frac32_t u_out = f32_limit(u_presat, limit);
    state->excess = (u_out == u_presat) ? 0 : sat32(u_out - u_presat);
    return u_out;
}

#endif
