#include "control/current_loop.h"

void current_loop_reset(current_loop_t *loop)
{
    loop->current = (dq_t){0, 0};
    loop->voltage = (dq_t){0, 0};
    loop->limited = false;
    pi_reset(&loop->d, 0);
    pi_reset(&loop->q, 0);
    loop->omega_e = 0;
    loop->minus_2_omega = 0;
    loop->rotation_sin = 0;
    loop->rotation_versine = 0;
}

void current_loop_limit(current_loop_t *loop, pi_sum_t sum_d, pi_sum_t sum_q, frac16_t u_d, frac16_t u_limit)
{
    frac16_t d = u_d;
    if (d > u_limit || d < -u_limit) {
        d = f16_from_f32(pi_limit(&loop->d, sum_d, f32_from_f16(u_limit)));
    } else {
        loop->d.excess = 0; /* usual case: the q voltage, against the back-EMF, reaches the limit */
    }
    const frac16_t limit_q = f16_sqrt(f32_mul16(u_limit, u_limit) - f32_mul16(d, d));
    const frac16_t q = f16_from_f32(pi_limit(&loop->q, sum_q, f32_from_f16(limit_q)));
    loop->voltage.d = d;
    loop->voltage.q = q;
    loop->limited = true;
}

void current_loop_set_speed(current_loop_t *loop, const current_loop_config_t *config, frac16_t omega_e)
{
    loop->omega_e = f32_from_f16(omega_e);
    loop->minus_2_omega = -2 * (int32_t)omega_e;
    const sin_cos_t turn = sin_cos(current_loop_rounded(pi_sum_add(0, loop->omega_e, config->angle_step)));
    loop->rotation_sin = turn.sin;
    loop->rotation_versine = FRAC16_MAX - ((turn.cos > 0) ? turn.cos : 0); /* a quarter turn per period and more: 1 */
}

/* Preset of the integral parts for e = 0: the voltage that the decoupling terms do not supply,
 *   u_id = u_d + omega_e L_q i_q,  u_iq = u_q - omega_e L_d i_d - omega_e psi_m. */
void current_loop_take_over(current_loop_t *loop, const current_loop_config_t *config, dq_t current, dq_t voltage)
{
    const pi_sum_t d = pi_sum_add(0, loop->minus_2_omega * current.q, config->omega_l_q);
    pi_sum_t q = pi_sum_add(0, loop->minus_2_omega * current.d, -config->omega_l_d);
    q = pi_sum_add(q, loop->omega_e, config->omega_psi);
    loop->current = current;
    loop->voltage = voltage;
    loop->d.integral = pi_sum_saturated(pi_sum_of(f32_from_f16(voltage.d)) - d);
    loop->q.integral = pi_sum_saturated(pi_sum_of(f32_from_f16(voltage.q)) - q);
    loop->d.excess = 0;
    loop->q.excess = 0;
}
