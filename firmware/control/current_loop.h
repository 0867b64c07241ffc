/* current_loop.h - current control in the fast loop: i_d, i_q, decoupling, bus-ripple compensation (DRM 2.3.2, F7). */
#ifndef SERVO_CONTROL_CURRENT_LOOP_H
#define SERVO_CONTROL_CURRENT_LOOP_H

#include "control/dead_time.h"
#include "control/pi.h"
#include "control/svm.h"

typedef struct {
    pi_gains_t d; /* Kp = omega_c L_d, Kp Ki Ts = omega_c R_s T: the zero cancels the pole of the winding */
    pi_gains_t q; /* Kp = omega_c L_q, Kp Ki Ts = omega_c R_s T */
    gain_t omega_l_d;  /* omega_e L_d i: full-scale speed x L_d x full-scale current / full-scale voltage */
    gain_t omega_l_q;  /* omega_e L_q i, scaled as omega_l_d; DRM E20 and E21 have one L_s, this rotor is salient */
    gain_t omega_psi;  /* omega_e psi_m */
    gain_t angle_step; /* electrical angle per PWM period at full-scale speed */
    dead_time_config_t dead_time;
    frac16_t modulation_limit; /* largest voltage / (2/3 u_dc); below sqrt(3)/2: low sides long enough for sampling */
} current_loop_config_t;

typedef struct {
    dq_t current; /* measured, Q1.15 of full-scale current */
    dq_t voltage; /* commanded, Q1.15 of full-scale voltage */
    ab_t stator_current; /* measured, stator frame, Q1.15 of full-scale current */
    ab_t stator_voltage; /* commanded, stator frame, Q1.15 of full-scale voltage */
    bool limited; /* the voltage was limited since this flag was cleared */
    bool dead_time_off; /* no compensation of the dead time */
    pi_state_t d;
    pi_state_t q;
    frac32_t omega_e; /* electrical speed, Q1.31 of full-scale speed x pole pairs */
    int32_t minus_2_omega; /* -2 x omega_e in Q1.15; the product with a Q1.15 current is -omega_e i in Q1.31 */
    int32_t rotation_sin; /* sine of the rotor rotation per PWM period, 15 fraction bits */
    int32_t rotation_versine; /* 1 - cosine of the rotor rotation per PWM period, 15 fraction bits */
} current_loop_t;

/* Reset to zero current, voltage and speed. */
void current_loop_reset(current_loop_t *loop);

/* Set the electrical speed `omega_e` (full scale: pole pairs x full-scale speed). Terms that depend on the speed
 * only are computed here, once per slow tick. */
void current_loop_set_speed(current_loop_t *loop, const current_loop_config_t *config, frac16_t omega_e);

/* Bumpless transfer to another frame: initialise the integrators so that the next output is `voltage` at the measured
 * `current`. */
void current_loop_take_over(current_loop_t *loop, const current_loop_config_t *config, dq_t current, dq_t voltage);

/* Bumpless change of gains: the integrators compensate the change of the proportional and decoupling terms. */
void current_loop_retune(current_loop_t *loop, const current_loop_config_t *before, const current_loop_config_t *config,
                         dq_t reference);

/* Limit the voltage to a circle; the d axis has priority, because it controls the flux: |u_d| <= u_limit, then
 * |u_q| <= sqrt(u_limit^2 - u_d^2). `u_d` is `sum_d`, rounded. */
void current_loop_limit(current_loop_t *loop, pi_sum_t sum_d, pi_sum_t sum_q, frac16_t u_d, frac16_t u_limit);

/* A quarter of the full scale (9 V), which is below the under-voltage limit. It bounds the quotient of the ripple
 * compensation. */
#define U_DC_MIN INT16_C(8192)

/* DC-bus ripple compensation: u / (2/3 u_dc) with the bus voltage of this period. */
static inline frac16_t current_loop_over_bus(frac16_t u, int32_t reciprocal)
{
    return sat16_asr(u * reciprocal + INT32_C(0x2000), 14);
}

/* Sum as frac16_t, rounded and saturated. */
static inline frac16_t current_loop_rounded(pi_sum_t sum)
{
    const int32_t upper = (int32_t)asr64(sum, 32);
    return sat16_asr(upper + (INT32_C(1) << (PI_SUM_BITS - 32 - 16)), PI_SUM_BITS - 32 - 15);
}

/* Rotor angle one period after the sample: the duties are loaded half a period later and hold for one period. */
static inline sin_cos_t current_loop_ahead(const current_loop_t *loop, sin_cos_t at)
{
    const int32_t s = loop->rotation_sin;
    const int32_t v = loop->rotation_versine;
    const sin_cos_t result = {
        sat16(at.sin + asr32(at.cos * s - at.sin * v + INT32_C(0x4000), 15)),
        sat16(at.cos - asr32(at.sin * s + at.cos * v + INT32_C(0x4000), 15)),
    };
    return result;
}

/* One PWM period T of the field-oriented current control: phase currents to duties. In the rotor frame, e = i* - i:
 *
 *   u_d = Kp_d e_d + u_id - omega_e L_q i_q                     PI controllers (pi.h), decoupling of the axes
 *   u_q = Kp_q e_q + u_iq + omega_e L_d i_d + omega_e psi_m     and feed-forward of the back-EMF (E18, E19)
 *   u_d^2 + u_q^2 <= u_limit^2                                  u_limit = modulation_limit 2/3 u_dc
 *   m = u e^(j (theta_e + omega_e T)) / (2/3 u_dc)              to the stator frame; compensation of the bus ripple
 *
 * `theta_e`: angle at the sampling instant; `u_dc`: bus voltage of this period. */
static inline svm_t current_loop_step(current_loop_t *loop, const current_loop_config_t *config, abc_t current,
                                      dq_t reference, frac16_t theta_e, frac16_t u_dc)
{
    const int32_t bus = (u_dc < U_DC_MIN) ? U_DC_MIN : u_dc;
    const sin_cos_t at = sin_cos(theta_e);
    const ab_t measured = clarke(current);
    const dq_t i = park(measured, at);
    loop->stator_current = measured;
    loop->current.d = i.d;
    loop->current.q = i.q;

    pi_sum_t sum_d = pi_sum(&loop->d, &config->d, f32_from_f16(f16_sub(reference.d, i.d)));
    sum_d = pi_sum_add(sum_d, loop->minus_2_omega * i.q, config->omega_l_q);
    pi_sum_t sum_q = pi_sum(&loop->q, &config->q, f32_from_f16(f16_sub(reference.q, i.q)));
    sum_q = pi_sum_add(sum_q, loop->minus_2_omega * i.d, -config->omega_l_d);
    sum_q = pi_sum_add(sum_q, loop->omega_e, config->omega_psi);

    /* E37: limit the voltage to a circle. */
    const int32_t u_limit = f16_mul((frac16_t)bus, config->modulation_limit);
    const int32_t u_d = current_loop_rounded(sum_d);
    const int32_t u_q = current_loop_rounded(sum_q);
    if ((uint32_t)(u_d * u_d) + (uint32_t)(u_q * u_q) <= (uint32_t)(u_limit * u_limit)) {
        loop->d.excess = 0;
        loop->q.excess = 0;
        loop->voltage.d = (frac16_t)u_d;
        loop->voltage.q = (frac16_t)u_q;
    } else {
        current_loop_limit(loop, sum_d, sum_q, (frac16_t)u_d, (frac16_t)u_limit);
    }

    const ab_t stator = park_inverse(loop->voltage, current_loop_ahead(loop, at));
    loop->stator_voltage = stator;
    const int32_t reciprocal = (INT32_C(1) << 29) / bus;
    const ab_t modulation = {current_loop_over_bus(stator.alpha, reciprocal),
                             current_loop_over_bus(stator.beta, reciprocal)};
    svm_t result = svm(modulation);
    if (!loop->dead_time_off) {
        result.duty = dead_time_compensate(&config->dead_time, result.duty, current, reciprocal);
    }
    return result;
}

#endif
