/* current_loop_retune.c - a file of its own, because it runs from flash and current_loop.c from RAM. */
#include "control/current_loop.h"

/* u_i' = u_i + (Kp - Kp') e + decoupling with the old values - decoupling with the new ones. */
void current_loop_retune(current_loop_t *loop, const current_loop_config_t *before, const current_loop_config_t *config,
                         dq_t reference)
{
    const dq_t i = loop->current;
    pi_sum_t d = pi_retuned(&loop->d, &before->d, &config->d, f32_from_f16(f16_sub(reference.d, i.d)));
    pi_sum_t q = pi_retuned(&loop->q, &before->q, &config->q, f32_from_f16(f16_sub(reference.q, i.q)));
    d = pi_sum_add(d, loop->minus_2_omega * i.q, before->omega_l_q - config->omega_l_q);
    q = pi_sum_add(q, loop->minus_2_omega * i.d, config->omega_l_d - before->omega_l_d);
    q = pi_sum_add(q, loop->omega_e, before->omega_psi - config->omega_psi);
    loop->d.integral = pi_sum_saturated(d);
    loop->q.integral = pi_sum_saturated(q);
}
