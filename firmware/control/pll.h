/* pll.h - phase-locked loop on the observed back-EMF (ST slides "Phase-locked loop (PLL)", "Calculation
 * of the closed-loop coefficients of the PLL").
 *
 * In the frame of DRM E13, per PWM period T:
 *
 *   phi     = theta + omega T / 2                               angle in the middle of the period of e
 *   error   = -(e_alpha cos(phi) + e_beta sin(phi))             phase detector: omega psi_m sin(phi_true - phi)
 *   omega_i = omega_i + Ki T error,  omega = omega_i + Kp error PI loop filter
 *   theta   = theta + omega T
 *
 * omega is electrical. Natural frequency sqrt(Ki omega psi_m), damping Kp sqrt(omega psi_m / Ki) / 2. The error is
 * negated at negative speed.
 * As on the slide the integral gain is constant: the natural frequency is proportional to the square root of the speed,
 * and at low speed below the sixth harmonic, the ripple of the dead time. The proportional gain is inversely
 * proportional to the square root of the back-EMF, for constant damping. Extension of the slide: acceleration
 * feed-forward from i_q.
 *
 * Angles: 2^32 is one electrical turn. Speeds are steps: angle per PWM period.
 */
#ifndef SERVO_CONTROL_PLL_H
#define SERVO_CONTROL_PLL_H

#include "control/back_emf_observer.h"

typedef struct {
    gain_t kp;         /* step / phase error, at full-scale back-EMF; phase errors have 14 + F2 fraction bits */
    gain_t ki;         /* step / phase error, per PWM period */
    frac16_t e_min;  /* back-EMF below which the proportional gain is constant, Q1.15 of full-scale voltage */
    int32_t step_max; /* largest step, 2^32 is one turn */
    int32_t speed_per_step;  /* speed (Q1.31 of full-scale speed) / step, 22 fraction bits */
    int32_t step_per_speed;  /* step at full-scale speed */
    int32_t counts_per_turn; /* encoder counts per electrical turn, 16 fraction bits */
    int32_t acceleration;    /* step change per slow tick at full-scale i_q; 0: no feed-forward */
    /* gain of the load-acceleration estimate: change per tick / (phase error x sqrt(back-EMF)), of full scales */
    int32_t load_gain;
    /* amplitude error: observed minus expected back-EMF, 23 fraction bits */
    gain_t amplitude_gain; /* gain from the amplitude error to `integral`, steps per slow tick */
    gain_t amplitude_load_gain; /* gain from that error to `load`, steps per slow tick; 0: amplitude not used */
    /* change of `bias` per slow tick (back-EMF, 23 fraction bits) / (integral - mean step of the angle), in steps */
    gain_t offset_gain;
} pll_config_t;

typedef struct {
    uint32_t angle; /* electrical angle at the next sample, 2^32 is one turn */
    int32_t integral; /* integrator: speed without the proportional term, as `step` */
    int32_t step; /* angle per PWM period, 2^32 is one turn */
    gain_t kp; /* proportional gain at the present back-EMF */
    frac16_t root; /* square root of the back-EMF, Q1.15 */
    int32_t load; /* estimated acceleration by the load, step change per slow tick */
    int32_t bias; /* amplitude offset of the back-EMF by errors of flux, resistance, dead time, 23 fraction bits */
    bool backwards; /* negative speed: the back-EMF is reversed */
} pll_t;

/* Initialise with the rotor at `angle`, rotating at `step`. */
void pll_reset(pll_t *pll, uint32_t angle, int32_t step);

/* Adapt the proportional gain to the amplitude `emf` of the back-EMF: Kp = 2 damping sqrt(Ki / emf). */
void pll_adapt(pll_t *pll, const pll_config_t *config, frac16_t emf);

/* One slow tick Ts: feed the acceleration by `i_q` forward, and correct speed and load estimate with the amplitude
 * error of the back-EMF, which responds to a load step before the phase:
 *
 *   a_load(k)  = a_load(k-1) + k_l error sqrt(emf) + k_al size
 *   omega_i(k) = omega_i(k-1) + Ts (p Kt i_q / J + a_load(k)) + k_a size,  size = e_q - omega psi_m - bias(k-1)
 *
 * `error` as above. `residual_emf`: observed minus expected back-EMF. `rotation`: change of the angle in this tick, from which the
 * amplitude offset `bias` is estimated. */
void pll_feed_forward(pll_t *pll, const pll_config_t *config, frac16_t i_q, dq_t residual_emf, int32_t rotation);

/* Bumpless change of the nominal values of motor and shaft, at the current `i_q`. */
void pll_retune(pll_t *pll, const pll_config_t *before, const pll_config_t *config, frac16_t i_q);

static inline frac16_t pll_upper(uint32_t angle) { return (frac16_t)(uint16_t)((angle + UINT32_C(0x8000)) >> 16); }

/* Electrical angle at the next sample. */
static inline frac16_t pll_theta(const pll_t *pll) { return pll_upper(pll->angle); }

/* After pll_step: rotor angle in the middle of the period of the observed back-EMF. */
static inline frac16_t pll_theta_of_emf(const pll_t *pll)
{
    return pll_upper(pll->angle - (uint32_t)asr32(pll->step, 1));
}

/* Mechanical speed of a step, Q1.31 of full-scale speed. */
static inline frac32_t pll_speed_of(const pll_config_t *config, int32_t step)
{
    return sat32(asr64((int64_t)step * config->speed_per_step, 22));
}

static inline int32_t pll_step_of(const pll_config_t *config, frac32_t speed)
{
    return (int32_t)asr64((int64_t)speed * config->step_per_speed, 31);
}

/* Advance the angle at constant speed. */
static inline void pll_coast(pll_t *pll) { pll->angle += (uint32_t)pll->step; }

/* One PWM period, after back_emf_observer_step. */
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
