/* back_emf_observer.h - Luenberger observer of currents and back-EMF in the stator frame (ST slide
 * "Luenberger observer of the PMSM").
 *
 *   L di/dt = v - R i - e,  de_alpha/dt = -omega e_beta,  de_beta/dt = omega e_alpha
 *
 * in the frame of DRM E13 and E14: e_alpha = -omega psi_m sin(theta), e_beta = omega psi_m cos(theta); L is the mean of
 * L_d and L_q. The slide uses the Euler method. Here decay and rotation are exact: the current decays with exp(-R T /
 * L), the back-EMF is rotated by omega T. e is the mean over one sampling period, so its angle is that of the middle of
 * the period.
 *
 *   error = i - measured,  i += K1 error,  e += K2 error        (K1 < 0, K2 > 0)
 *   e rotates by omega T,  i -> a i + b (v - e)                 (until the next sample)
 */
#ifndef SERVO_CONTROL_BACK_EMF_OBSERVER_H
#define SERVO_CONTROL_BACK_EMF_OBSERVER_H

#include "control/transforms.h"

/* F1 and F2 of the slide are powers of two: fraction bits of the states beyond the 15 bits of a sample. With 11
 * additional bits the range of a state is sixteen times the full scale. */
typedef struct {
    uint16_t f1; /* fraction bits of currents beyond 15 */
    uint16_t f2; /* fraction bits of voltages beyond 15 */
    int32_t loss; /* 1 - a = 1 - exp(-R T / L), 32 fraction bits */
    int32_t drive; /* b = (1 - a) / R, of full scales, times 2^(F1 - F2), 32 fraction bits */
    int32_t k1; /* p1 p2 / a - 1 for the poles p1 and p2, 31 fraction bits */
    int32_t k2; /* (1 - p1) (1 - p2) / b, of full scales, times 2^(F2 - F1), 28 fraction bits */
} back_emf_observer_config_t;

/* Vector in the stator frame. */
typedef struct {
    int32_t alpha; /* 15 + F1 fraction bits of full-scale current, or 15 + F2 of full-scale voltage */
    int32_t beta; /* 15 + F1 fraction bits of full-scale current, or 15 + F2 of full-scale voltage */
} back_emf_observer_ab_t;

typedef struct {
    back_emf_observer_ab_t i; /* predicted current at the next sample */
    back_emf_observer_ab_t e; /* mean back-EMF until the next sample */
    ab_t v; /* last commanded voltage */
    int32_t rotation_sin; /* sine of the rotor rotation per PWM period, 32 fraction bits */
    int32_t rotation_versine; /* 1 - cosine of the rotor rotation per PWM period, 32 fraction bits */
} back_emf_observer_t;

/* Reset to zero voltage and back-EMF, and to the measured current. */
void back_emf_observer_reset(back_emf_observer_t *observer, const back_emf_observer_config_t *config, ab_t current);

/* Set the rotor rotation per PWM period; 2^32 is one turn. */
void back_emf_observer_set_speed(back_emf_observer_t *observer, int32_t step);

/* Back-EMF, Q1.15 of full-scale voltage. */
ab_t back_emf_observer_emf(const back_emf_observer_t *observer, const back_emf_observer_config_t *config);

static inline int32_t back_emf_observer_upper(int32_t x, int32_t factor)
{
    return (int32_t)asr64((int64_t)x * factor, 32);
}

static inline int32_t back_emf_observer_part(int32_t x, int32_t factor, unsigned bits)
{
    return (int32_t)asr64((int64_t)x * factor, bits);
}

/* One sample of the current; `voltage` corresponds to the duties computed from it. The duties are loaded half a period
 * later, so the mean voltage until the next sample is the mean of `voltage` and its predecessor.
 *
 * Sums wrap: an unstable choice of gains causes arbitrary states, which emf_check.h and speed_reliability.h detect. */
static inline void back_emf_observer_step(back_emf_observer_t *observer, const back_emf_observer_config_t *config,
                                          ab_t current, ab_t voltage)
{
    const back_emf_observer_ab_t error = {
        i32_sub_wrap(observer->i.alpha, current.alpha * (INT32_C(1) << config->f1)),
        i32_sub_wrap(observer->i.beta, current.beta * (INT32_C(1) << config->f1)),
    };
    const back_emf_observer_ab_t i = {
        i32_add_wrap(observer->i.alpha, back_emf_observer_part(error.alpha, config->k1, 31)),
        i32_add_wrap(observer->i.beta, back_emf_observer_part(error.beta, config->k1, 31)),
    };
    const back_emf_observer_ab_t at = {
        i32_add_wrap(observer->e.alpha, back_emf_observer_part(error.alpha, config->k2, 28)),
        i32_add_wrap(observer->e.beta, back_emf_observer_part(error.beta, config->k2, 28)),
    };
    const int32_t s = observer->rotation_sin;
    const int32_t c = observer->rotation_versine;
    const back_emf_observer_ab_t e = {
        i32_sub_wrap(i32_sub_wrap(at.alpha, back_emf_observer_upper(at.alpha, c)), back_emf_observer_upper(at.beta, s)),
        i32_add_wrap(i32_sub_wrap(at.beta, back_emf_observer_upper(at.beta, c)), back_emf_observer_upper(at.alpha, s)),
    };
    const int32_t half = INT32_C(1) << (config->f2 - 1U);
    const int32_t rest_alpha = i32_sub_wrap(((int32_t)observer->v.alpha + voltage.alpha) * half, e.alpha);
    const int32_t rest_beta = i32_sub_wrap(((int32_t)observer->v.beta + voltage.beta) * half, e.beta);
    observer->i.alpha = i32_add_wrap(i32_sub_wrap(i.alpha, back_emf_observer_upper(i.alpha, config->loss)),
                                     back_emf_observer_upper(rest_alpha, config->drive));
    observer->i.beta = i32_add_wrap(i32_sub_wrap(i.beta, back_emf_observer_upper(i.beta, config->loss)),
                                    back_emf_observer_upper(rest_beta, config->drive));
    observer->e = e;
    observer->v = voltage;
}

#endif
