/* pi.h - PI controller with back-calculation anti-windup (DRM 2.5.2, E34..E37). */
#ifndef SERVO_CONTROL_PI_H
#define SERVO_CONTROL_PI_H

#include "math/frac.h"

typedef struct {
    gain_t kp; /* Kp */
    gain_t ki; /* Kp Ki Ts */
    gain_t kc; /* Kc, between 0 (no anti-windup) and 1 */
} pi_gains_t;

/* Sum of products fraction x gain, not yet rounded: 55 fraction bits, which leaves +-256. The gains that are added in one
 * sum stay below 255 together. */
typedef int64_t pi_sum_t;
#define PI_SUM_BITS (31 + GAIN_BITS)

typedef struct {
    pi_sum_t integral; /* u_i(k-1), within +-1 */
    frac32_t excess;   /* u_out(k-1) - u_presat(k-1) */
} pi_state_t;

void pi_reset(pi_state_t *state, frac32_t integral);

/* The sum that is this fraction. */
static inline pi_sum_t pi_sum_of(frac32_t x) { return (pi_sum_t)x * (INT32_C(1) << GAIN_BITS); }

/* sum + x gain */
static inline pi_sum_t pi_sum_add(pi_sum_t sum, frac32_t x, gain_t gain) { return sum + (int64_t)x * gain; }

/* Within +-1. Almost always it is, and the upper half of the sum tells. */
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

/* First half of a sample, E35 and E36: u_i. The anti-windup term goes into the integrator, as DRM 2.5.2 says in words;
 * E36 as printed would leave the integrator winding up. */
static inline void pi_integrate(pi_state_t *state, const pi_gains_t *gains, frac32_t error)
{
    const pi_sum_t integral = pi_sum_add(state->integral, error, gains->ki);
    state->integral = pi_sum_saturated(pi_sum_add(integral, state->excess, gains->kc));
}

/* The same, and u_p + u_i. Feed-forward may be added to this before the second half. */
static inline pi_sum_t pi_sum(pi_state_t *state, const pi_gains_t *gains, frac32_t error)
{
    pi_integrate(state, gains, error);
    return pi_sum_add(state->integral, error, gains->kp);
}

/* u_i with which other gains give the same sum for the same error; not yet within +-1. */
static inline pi_sum_t pi_retuned(const pi_state_t *state, const pi_gains_t *before, const pi_gains_t *gains,
                                  frac32_t error)
{
    return pi_sum_add(state->integral, error, before->kp - gains->kp);
}

/* Second half, E37: u_out within +-limit. */
static inline frac32_t pi_limit(pi_state_t *state, pi_sum_t sum, frac32_t limit)
{
    const int64_t u_presat = asr64(sum + (INT32_C(1) << (GAIN_BITS - 1)), GAIN_BITS);
    const frac32_t u_out = f32_limit(u_presat, limit);
    state->excess = (u_out == u_presat) ? 0 : sat32(u_out - u_presat);
    return u_out;
}

#endif
