/* back_emf_observer.h - Luenberger observer of currents and back-EMF in the stator frame (ST slide "PMSM 马达的Luenberger观测器").
 *
 *   L di/dt = v - R i - e,  de_alpha/dt = -omega e_beta,  de_beta/dt = omega e_alpha
 *
 * in the frame of DRM E13 and E14: e_alpha = -omega psi_m sin(theta), e_beta = omega psi_m cos(theta); L is the mean of L_d
 * and L_q. The slide takes Euler's step. Here the current decays as it does in a period, and the back-EMF turns as far as
 * the rotor does, so that its angle is true at any speed. What is called e is the mean over a period between two samples:
 * it points as it does in the middle of it.
 *
 *   error = i - measured,  i += K1 error,  e += K2 error        (K1 < 0, K2 > 0)
 *   e turns,  i -> a i + b (v - e)                              (until the next sample)
 */
#ifndef SERVO_CONTROL_BACK_EMF_OBSERVER_H
#define SERVO_CONTROL_BACK_EMF_OBSERVER_H

#include "control/transforms.h"

/* F1 and F2 of the slide, as powers of two: what the states have more than the 15 bits of a sample. With 11 of them a
 * state holds sixteen times the full scale, more than any transient needs. */
typedef struct {
    uint16_t f1; /* fraction bits of currents, less 15 */
    uint16_t f2; /* fraction bits of voltages, less 15 */
    int32_t loss; /* 1 - a = 1 - exp(-R T / L), 32 fraction bits */
    int32_t drive; /* b = (1 - a) / R, of full scales, times 2^(F1 - F2), 32 fraction bits */
    int32_t k1; /* p1 p2 / a - 1 for the poles p1 and p2, 31 fraction bits */
    int32_t k2; /* (1 - p1) (1 - p2) / b, of full scales, times 2^(F2 - F1), 28 fraction bits */
} back_emf_observer_config_t;

/* Stator frame, with the bits of F1 or F2. */
typedef struct {
    int32_t alpha; /* F1 or F2 + 15 fraction bits of full-scale current or voltage */
    int32_t beta; /* the same */
} back_emf_observer_ab_t;

typedef struct {
    back_emf_observer_ab_t i; /* at the next sample, as predicted */
    back_emf_observer_ab_t e; /* mean until the next sample */
    ab_t v; /* voltage that was commanded last */
    int32_t turn_sin; /* of the angle that the rotor turns in a period, 32 fraction bits */
    int32_t turn_versine; /* 1 - cosine of it */
} back_emf_observer_t;

/* No voltage, no back-EMF, and no current but the one that is measured. */
void back_emf_observer_reset(back_emf_observer_t *observer, const back_emf_observer_config_t *config, ab_t current);

/* The rotor turns by `step` in a period, 2^32 is a turn. */
void back_emf_observer_set_speed(back_emf_observer_t *observer, int32_t step);

/* Back-EMF as fractions. */
ab_t back_emf_observer_emf(const back_emf_observer_t *observer, const back_emf_observer_config_t *config);

static inline int32_t back_emf_observer_upper(int32_t x, int32_t factor)
{
    return (int32_t)asr64((int64_t)x * factor, 32);
}

static inline int32_t back_emf_observer_part(int32_t x, int32_t factor, unsigned bits)
{
    return (int32_t)asr64((int64_t)x * factor, bits);
}

/* The sums wrap: with gains that make the observer unstable its states go round, which its checks see.
 *
 * A sample was taken; `voltage` is what the duties computed from it stand for. They load half a period later, so the mean
 * voltage until the next sample is half theirs and half their predecessors'. */
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
    const int32_t s = observer->turn_sin;
    const int32_t c = observer->turn_versine;
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
