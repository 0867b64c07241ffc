#include "plant/switched_inverter_motor.h"

#define ROTATIONS_MAX 64u /* incremental updates of sine and cosine between two evaluations */

static plant_vector_t to_rotor(plant_vector_t x, double c, double s)
{
    return (plant_vector_t){x.alpha * c + x.beta * s, x.beta * c - x.alpha * s};
}

static plant_vector_t to_stator(plant_vector_t x, double c, double s)
{
    return (plant_vector_t){x.alpha * c - x.beta * s, x.beta * c + x.alpha * s};
}

static saturation_t iron_d(const switched_inverter_t *inv) { return (saturation_t){inv->l_d, inv->per_s_d}; }

static saturation_t iron_q(const switched_inverter_t *inv) { return (saturation_t){inv->l_q, inv->per_s_q}; }

plant_vector_t inverter_saturated_current(const switched_inverter_t *inv, plant_vector_t psi, double c, double s)
{
    const plant_vector_t flux = to_rotor(psi, c, s);
    const plant_vector_t i = {saturation_current(iron_d(inv), flux.alpha - inv->psi_m),
                              saturation_current(iron_q(inv), flux.beta)};
    return to_stator(i, c, s);
}

void inverter_set_inductances(switched_inverter_t *inv, double l_d, double l_q)
{
    inv->inv_l_mean = 0.5 / l_d + 0.5 / l_q;
    inv->inv_l_half = 0.5 / l_d - 0.5 / l_q;
    const double inv_l_min = inv->inv_l_mean - fabs(inv->inv_l_half);
    inv->inv_l_max = inv->inv_l_mean + fabs(inv->inv_l_half);
    inv->saliency = inv->inv_l_max / inv_l_min;
    const double direct = (0.5 * inv->inv_l_mean + fabs(inv->inv_l_half)) / inv_l_min;
    inv->coupling = direct + direct * direct; /* directly, and through the third phase */
}

void inverter_update_saturated_inductances(switched_inverter_t *inv)
{
    const plant_vector_t flux = to_rotor(inv->psi, inv->cosine, inv->sine);
    inverter_set_inductances(inv, saturation_inductance(iron_d(inv), flux.alpha - inv->psi_m),
                             saturation_inductance(iron_q(inv), flux.beta));
    inv->inverse = inverse_of(inv, inv->cosine, inv->sine);
}

void inverter_update_flux(switched_inverter_t *inv)
{
    double d = inv->l_d * (inv->i.alpha * inv->cosine + inv->i.beta * inv->sine);
    double q = inv->l_q * (inv->i.beta * inv->cosine - inv->i.alpha * inv->sine);
    if (inv->saturates) {
        d = saturation_flux(iron_d(inv), d / inv->l_d);
        q = saturation_flux(iron_q(inv), q / inv->l_q);
    }
    d += inv->psi_m;
    inv->psi.alpha = d * inv->cosine - q * inv->sine;
    inv->psi.beta = d * inv->sine + q * inv->cosine;
    inv->torque = inv->k_torque * cross(inv->psi, inv->i);
}

void inverter_remove_phase_current(switched_inverter_t *inv, int k)
{
    const double i_k = dot(inv->i, phase_axis[k]);
    inv->i.alpha -= i_k * phase_axis[k].alpha;
    inv->i.beta -= i_k * phase_axis[k].beta;
    phases_of(inv->i, inv->phase);
    inv->phase[k] = 0.0;
    inv->phase[(k + 1) % 3] = -inv->phase[(k + 2) % 3];
    inverter_update_flux(inv);
}

void inverter_evaluate_angle(switched_inverter_t *inv)
{
    plant_sincos(inv->pole_pairs * inv->theta, &inv->sine, &inv->cosine);
    inv->inverse = inverse_of(inv, inv->cosine, inv->sine);
}

void inverter_count_rotation(switched_inverter_t *inv)
{
    if (++inv->rotations >= ROTATIONS_MAX) {
        inv->rotations = 0;
        inverter_evaluate_angle(inv);
    }
}
