#include "control/current_loop.h"

/* A quarter of the full scale (9 V): below it the inverter is off for under-voltage anyway, and the division of the
 * ripple compensation stays in range. */
#define U_DC_LEAST INT16_C(8192)

void current_loop_reset(current_loop_t *loop)
{
    pi_reset(&loop->d, 0);
    pi_reset(&loop->q, 0);
}

/* DC-bus ripple compensation: the voltage as a part of the bus that is there now, u / (2/3 u_dc). */
static frac16_t over_bus(frac16_t u, int32_t reciprocal) { return sat16(asr32(u * reciprocal + INT32_C(0x2000), 14)); }

current_loop_output_t current_loop_step(current_loop_t *loop, const current_loop_config_t *config, abc_t current,
                                        dq_t reference, frac16_t theta_e, frac16_t omega_e, frac16_t u_dc)
{
    current_loop_output_t out;
    const frac16_t bus = (u_dc < U_DC_LEAST) ? U_DC_LEAST : u_dc;

    const dq_t i = park(clarke(current), sin_cos(theta_e));
    out.current = i;

    /* E18, E19: what the rotation couples from one axis into the other. */
    const frac32_t back_emf = f32_gain(f32_from_f16(omega_e), config->omega_psi);
    const frac32_t couple_d = f32_gain(f32_mul16(omega_e, i.q), -config->omega_l_q);
    const frac32_t couple_q = f32_add(back_emf, f32_gain(f32_mul16(omega_e, i.d), config->omega_l_d));

    /* The voltage is limited to a circle; the d axis, which keeps the flux, goes first. */
    const frac16_t u_limit = f16_mul(bus, config->modulation_limit);
    const frac32_t e_d = f32_from_f16(f16_sub(reference.d, i.d));
    const frac32_t e_q = f32_from_f16(f16_sub(reference.q, i.q));
    out.voltage.d = f16_from_f32(pi_step(&loop->d, &config->d, e_d, couple_d, f32_from_f16(u_limit)));
    const frac32_t rest = f32_sub(f32_mul16(u_limit, u_limit), f32_mul16(out.voltage.d, out.voltage.d));
    const frac16_t u_limit_q = f16_sqrt(rest);
    out.voltage.q = f16_from_f32(pi_step(&loop->q, &config->q, e_q, couple_q, f32_from_f16(u_limit_q)));
    out.limited = (loop->d.excess != 0) || (loop->q.excess != 0);

    /* The duties load half a period after the sample and hold for a whole one: their centre lies one period ahead. */
    const frac16_t advance = f16_from_f32(f32_gain(f32_from_f16(omega_e), config->angle_step));
    const ab_t u = park_inverse(out.voltage, sin_cos(f16_add_wrap(theta_e, advance)));
    const int32_t reciprocal = (INT32_C(1) << 29) / bus;
    const ab_t modulation = {over_bus(u.alpha, reciprocal), over_bus(u.beta, reciprocal)};
    out.modulation = svm(modulation);
    if (!loop->dead_time_off) {
        out.modulation.duty = dead_time_compensate(&config->dead_time, out.modulation.duty, current, reciprocal);
    }
    return out;
}
