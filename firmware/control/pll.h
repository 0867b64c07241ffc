/* pll.h - phase-locked loop on the observed back-EMF (ST slides "锁相环 (PLL)", "PLL 闭环系数计算").
 *
 * In the frame of DRM E13 the error is -(e_alpha cos(theta) + e_beta sin(theta)), which is |omega| psi_m times the sine of the
 * angle that is missing, times the sign of the speed. As on the slide the integral gain is a constant: the natural frequency
 * grows with the root of the speed, and at low speed stays below the ripple of the dead time, the sixth harmonic. The
 * proportional gain goes down with the root of the back-EMF, which keeps the damping. Beyond the slide, the torque of the
 * current changes the speed at once, so that a speed controller need not wait for the angle to trail.
 *
 * Angles: 2^32 is an electrical turn. Speeds are steps: the angle per PWM period.
 */
#ifndef SERVO_CONTROL_PLL_H
#define SERVO_CONTROL_PLL_H

#include "control/back_emf_observer.h"

typedef struct {
    gain_t kp;         /* step per error, for a back-EMF of the full scale; errors have 14 + F2 fraction bits */
    gain_t ki;         /* step per error and period */
    frac16_t e_min;  /* below this back-EMF (of full-scale voltage) the proportional gain grows no further */
    int32_t step_max; /* largest step */
    int32_t speed_per_step;  /* speed fraction (31 bits) of a step, 22 fraction bits */
    int32_t step_per_speed;  /* step at full-scale speed */
    int32_t counts_per_turn; /* encoder counts of an electrical turn, 16 fraction bits */
    int32_t acceleration;    /* steps gained in a slow tick by the full-scale i_q; 0 leaves the torque out */
    int32_t load; /* what they change by in a slow tick, per error and root of the back-EMF, of full scales */
    gain_t follow; /* step gained in a slow tick per back-EMF, 23 bits, that the speed does not explain .. */
    gain_t follow_load; /* .. and what is learnt from it; 0 leaves the size out */
    gain_t forget; /* back-EMF, 23 bits, per step by which the size says something else than the phase */
} pll_config_t;

typedef struct {
    uint32_t angle; /* at the next sample */
    int32_t integral; /* speed without the ripple of the error */
    int32_t step; /* angle per PWM period, 2^32 is a turn */
    gain_t kp; /* for the back-EMF that there is */
    frac16_t root; /* root of the back-EMF, Q1.15 */
    int32_t load; /* steps per slow tick that the known torque does not explain */
    int32_t bias; /* back-EMF, 23 bits, that is there or missing at this speed for good: flux, resistance, dead time */
    bool backwards; /* the speed is negative: the back-EMF points the other way */
} pll_t;

/* Turning at `step` with the rotor at `angle`. */
void pll_reset(pll_t *pll, uint32_t angle, int32_t step);

/* Take the damping to a back-EMF of this size. */
void pll_adapt(pll_t *pll, const pll_config_t *config, frac16_t emf);

/* Once per slow tick. The torque that is known of changes the speed, and what is not known of shows as an angle that
 * trails, and sooner as a back-EMF of another size. `beside` is the back-EMF that neither angle nor speed explain. In the
 * long run the phase is right and not the size: `turned` is how far the angle has gone in the tick. */
void pll_feed_forward(pll_t *pll, const pll_config_t *config, frac16_t i_q, dq_t beside, int32_t turned);

/* Other nominal values of motor and shaft without a step of the acceleration, while `i_q` flows. */
void pll_retune(pll_t *pll, const pll_config_t *before, const pll_config_t *config, frac16_t i_q);

static inline frac16_t pll_upper(uint32_t angle) { return (frac16_t)(uint16_t)((angle + UINT32_C(0x8000)) >> 16); }

/* Electrical angle at the next sample. */
static inline frac16_t pll_theta(const pll_t *pll) { return pll_upper(pll->angle); }

/* Rotor angle in the middle of the period that the observer's e belongs to, after this period's step. */
static inline frac16_t pll_theta_of_emf(const pll_t *pll)
{
    return pll_upper(pll->angle - (uint32_t)asr32(pll->step, 1));
}

/* Mechanical speed. */
static inline frac32_t pll_speed_of(const pll_config_t *config, int32_t step)
{
    return sat32(asr64((int64_t)step * config->speed_per_step, 22));
}

static inline int32_t pll_step_of(const pll_config_t *config, frac32_t speed)
{
    return (int32_t)asr64((int64_t)speed * config->step_per_speed, 31);
}

/* Go on at the same speed. */
static inline void pll_coast(pll_t *pll) { pll->angle += (uint32_t)pll->step; }

/* A sample was taken, and the observer has made its step. */
static inline void pll_step(pll_t *pll, const pll_config_t *config, back_emf_observer_ab_t e)
{
    const sin_cos_t at = sin_cos(pll_upper(pll->angle + (uint32_t)asr32(pll->step, 1)));
    const int32_t across = (int32_t)asr64((int64_t)e.alpha * at.cos + (int64_t)e.beta * at.sin, 16);
    const int32_t error = pll->backwards ? across : -across;
    pll->integral = f32_clip(pll->integral + f32_gain(error, config->ki), config->step_max);
    pll->step = f32_clip(f32_add(pll->integral, f32_gain(error, pll->kp)), config->step_max);
    pll_coast(pll);
}

#endif
