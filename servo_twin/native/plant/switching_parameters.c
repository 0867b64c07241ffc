#include "plant/switching_parameters.h"

#include <string.h>

#include "plant/switching_schedule.h"

void switching_apply_load(switching_t *plant, int i, double torque)
{
    shaft_t *shaft = &plant->shaft[i];
    shaft->load = plant->parameters[i].load_torque = torque;
    plant->stop[i].load = shaft->two_masses ? 0.0 : torque; /* with a second mass, the load acts on that */
    /* the next step of the shaft adds the torque of end stops, shaft and cogging */
    plant->axis[i].inverter.load = plant->stop[i].load + (shaft->two_masses ? shaft->torque : 0.0);
}

void switching_apply_axis(switching_t *plant, int i, const board_config_t *config)
{
    const plant_axis_t *c = &config->axis[i];
    switching_axis_t *axis = &plant->axis[i];
    const double l = (c->l_d < c->l_q) ? c->l_d : c->l_q;
    plant->parameters[i] = *c;
    shaft_change(&plant->shaft[i], c, axis->inverter.theta, axis->inverter.omega);
    plant->stop[i] = end_stop_of(c, plant->shaft[i].fine ? SHAFT_STEP : 1.0 / config->pwm_frequency);
    switching_apply_load(plant, i, c->load_torque);
    axis->dead_time_min = (uint64_t)(c->dead_time_min * SWITCHING_CLOCK_HZ + 0.5);
    axis->i_break = c->i_break;
    axis->square_break = c->i_break * c->i_break;
    const double far = c->i_break - 2.0 * config->bus.u_source / l * SWITCHING_HORIZON * CLOCK;
    axis->square_far = (far > 0.0) ? far * far : 0.0;
    axis->codes_per_ampere = 2048.0 / c->i_full_scale;
    memcpy(axis->i_offset, c->i_offset, sizeof axis->i_offset);
    axis->r_s = c->r_s;
}

void switching_apply_bus(switching_t *plant, const plant_bus_t *bus)
{
    plant->u_noise = plant_faults_noise(&plant->u_noise_configured, plant->u_noise, bus->u_noise);
    plant->codes_per_volt = 4096.0 / bus->u_full_scale;
}

double switching_magnet_flux(const switching_t *plant, int i)
{
    const plant_axis_t *c = &plant->parameters[i];
    return c->psi_m * (1.0 + c->magnet_coefficient * (plant->t_magnet[i] - plant->axis[i].winding.ambient));
}
