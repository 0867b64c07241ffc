/* current_loop.h - the fast loop's controllers: i_d, i_q, decoupling, bus-ripple compensation (DRM 2.3.2, F7). */
#ifndef SERVO_CONTROL_CURRENT_LOOP_H
#define SERVO_CONTROL_CURRENT_LOOP_H

#include "control/dead_time.h"
#include "control/pi.h"
#include "control/svm.h"

typedef struct {
    pi_gains_t d;
    pi_gains_t q;
    gain_t omega_l_d;  /* omega_e L_d i: full-scale speed x L_d x full-scale current / full-scale voltage */
    gain_t omega_l_q;  /* the same with L_q: DRM E20/E21 write one L_s, the rotor has two */
    gain_t omega_psi;  /* omega_e psi_m */
    gain_t angle_step; /* electrical angle per PWM period at full-scale speed */
    dead_time_config_t dead_time;
    frac16_t modulation_limit; /* longest voltage over 2/3 u_dc; sqrt(3)/2 would leave a low side too short to sample */
} current_loop_config_t;

typedef struct {
    dq_t current; /* measured, Q1.15 of full-scale current */
    dq_t voltage; /* commanded, Q1.15 of full-scale voltage */
    ab_t stator_current; /* the same in the stator frame */
    ab_t stator_voltage;
    bool limited; /* the voltage has been at its limit since this was cleared */
    bool dead_time_off; /* leave the duties as the SVM made them */
    pi_state_t d;
    pi_state_t q;
    frac32_t omega_e; /* electrical speed */
    int32_t minus_2_omega; /* the same, 14 fraction bits */
    int32_t turn_sin; /* of the angle that the rotor turns in one period, 15 fraction bits */
    int32_t turn_versine; /* 1 - cosine of it */
} current_loop_t;

/* At rest, without current and voltage. */
void current_loop_reset(current_loop_t *loop);

/* From now on the rotor turns with the electrical speed `omega_e` (full scale: pole pairs x full-scale speed). Speed is
 * measured once per slow tick, so what follows from it alone is worked out here and not in every period. */
void current_loop_set_speed(current_loop_t *loop, const current_loop_config_t *config, frac16_t omega_e);

/* Go on from here, in another frame: `current` flows, and `voltage` is what the next period is to have. */
void current_loop_take_over(current_loop_t *loop, const current_loop_config_t *config, dq_t current, dq_t voltage);

/* Other gains without a step of the voltage: the integral parts take what proportional part and decoupling of the last
 * sample lose or gain. */
void current_loop_retune(current_loop_t *loop, const current_loop_config_t *before, const current_loop_config_t *config,
                         dq_t reference);

/* Limit the voltage to a circle; the d axis, which keeps the flux, goes first. `u_d` is what `sum_d` rounds to. */
void current_loop_limit(current_loop_t *loop, pi_sum_t sum_d, pi_sum_t sum_q, frac16_t u_d, frac16_t u_limit);

/* A quarter of the full scale (9 V): below it the inverter is off for under-voltage anyway, and the division of the
 * ripple compensation stays in range. */
#define U_DC_MIN INT16_C(8192)

/* DC-bus ripple compensation: the voltage as a part of the bus that is there now, u / (2/3 u_dc). */
static inline frac16_t current_loop_over_bus(frac16_t u, int32_t reciprocal)
{
    return sat16_asr(u * reciprocal + INT32_C(0x2000), 14);
}

/* A sum as frac16_t, rounded; more than 1.0 saturates. */
static inline frac16_t current_loop_rounded(pi_sum_t sum)
{
    const int32_t upper = (int32_t)asr64(sum, 32);
    return sat16_asr(upper + (INT32_C(1) << (PI_SUM_BITS - 32 - 16)), PI_SUM_BITS - 32 - 15);
}

/* Where the rotor will be one period after the sample: the duties load half a period later and hold for a whole one. */
static inline sin_cos_t current_loop_ahead(const current_loop_t *loop, sin_cos_t at)
{
    const int32_t s = loop->turn_sin;
    const int32_t v = loop->turn_versine;
    const sin_cos_t result = {
        sat16(at.sin + asr32(at.cos * s - at.sin * v + INT32_C(0x4000), 15)),
        sat16(at.cos - asr32(at.sin * s + at.cos * v + INT32_C(0x4000), 15)),
    };
    return result;
}

/* One PWM period: from the phase currents to duties. `theta_e` is the angle at the sampling instant, `u_dc` the voltage of
 * the bus in this period. */
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

    /* E34..E36, and E18, E19: what the rotation couples from one axis into the other. */
    pi_sum_t sum_d = pi_sum(&loop->d, &config->d, f32_from_f16(f16_sub(reference.d, i.d)));
    sum_d = pi_sum_add(sum_d, loop->minus_2_omega * i.q, config->omega_l_q);
    pi_sum_t sum_q = pi_sum(&loop->q, &config->q, f32_from_f16(f16_sub(reference.q, i.q)));
    sum_q = pi_sum_add(sum_q, loop->minus_2_omega * i.d, -config->omega_l_d);
    sum_q = pi_sum_add(sum_q, loop->omega_e, config->omega_psi);

    /* E37: the voltage is limited to a circle. */
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
