/* What can be read from the switching plant: pins of the chip, and the true state. */
#include <string.h>

#include "plant/switching_axis.h"

/* ---- pins of the chip ------------------------------------------------------------------------------------------------- */

/* Outputs of the amplifiers at the present clock, which both converters sample. */
static void update_amplifiers(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    (void)switching_next(plant); /* with a valid segment */
    if (!switched_inverter_amplifiers(&axis->inverter, seconds(axis->clock, plant->now), plant->supply.u,
                                      axis->shown)) {
        switching_advance_axis(plant, i);
        switching_find_next_event(plant);
        memcpy(axis->shown, axis->inverter.amplifier, sizeof axis->shown);
    }
    axis->shown_clock = plant->now;
}

uint16_t switching_current_code(switching_t *plant, int i, int phase)
{
    switching_axis_t *axis = &plant->axis[i];
    if (axis->shown_clock != plant->now) {
        update_amplifiers(plant, i);
    }
    const double shown =
        axis->shown[INVERTER_LANE(phase)] + axis->i_offset[phase] + axis->i_noise * plant_random_gauss(&axis->noise);
    return plant_faults_code(&axis->faults, phase, plant_code(2048.0 + shown * axis->codes_per_ampere));
}

uint16_t switching_bus_code(switching_t *plant)
{
    (void)switching_next(plant);
    switching_advance_supply(plant);
    const double shown = plant->supply.u + plant->u_noise * plant_random_gauss(&plant->noise);
    return plant_code(shown * plant->codes_per_volt);
}

bool switching_over_current(const switching_t *plant, int axis) { return plant->axis[axis].tripped; }

bool switching_line(const switching_t *plant, int axis, int line)
{
    return quadrature_level(&plant->axis[axis].encoder, line);
}

/* ---- true state ------------------------------------------------------------------------------------------------------- */

/* Copy of the plant with the bus and one axis advanced to the present clock. */
static switching_t advanced_copy(const switching_t *plant, int axis)
{
    switching_t copy = *plant;
    switching_find_next_event(&copy);
    switching_advance_supply(&copy);
    switching_advance_axis(&copy, axis);
    switched_inverter_sync(&copy.axis[axis].inverter);
    return copy;
}

double switching_theta(const switching_t *plant, int i)
{
    const switching_axis_t *axis = &plant->axis[i];
    return axis->inverter.theta + axis->inverter.omega * seconds(axis->clock, plant->now);
}

void switching_truth(const switching_t *plant, int i, switching_truth_t *truth)
{
    switching_t copy = advanced_copy(plant, i);
    switching_find_next_event(&copy);
    const switching_axis_t *axis = &copy.axis[i];
    const switched_inverter_t *inv = &axis->inverter;
    const shaft_t *shaft = &copy.shaft[i];
    const bool two = shaft->two_masses;
    const double rest = two ? seconds(copy.now, copy.shaft_clock) : 0.0;
    *truth = (switching_truth_t){
        .theta = inv->theta,
        .omega = inv->omega,
        .i_d = inv->i.alpha * inv->cosine + inv->i.beta * inv->sine,
        .i_q = inv->i.beta * inv->cosine - inv->i.alpha * inv->sine,
        .torque = inv->torque,
        .impulse = inv->impulse,
        .theta_load = two ? shaft->theta - rest * (shaft->omega - 0.5 * rest * shaft->accel) : inv->theta,
        .omega_load = two ? shaft->omega - rest * shaft->accel : inv->omega,
        .torque_shaft = two ? shaft->torque : 0.0,
        .t_magnet = copy.t_magnet[i],
        .r_s = inv->r_s,
        .psi_m = inv->psi_m,
        .l_d = 1.0 / (inv->inv_l_mean + inv->inv_l_half),
        .l_q = 1.0 / (inv->inv_l_mean - inv->inv_l_half),
        .t_winding = axis->winding.t,
        .t_sink = axis->sink.t,
        .e_bus = inv->e_bus,
        .e_copper = inv->e_copper,
        .e_switch = inv->e_switch,
        .over_current = axis->tripped,
    };
    for (int k = 0; k < 3; k++) {
        truth->voltage[k] = axis->voltage[k];
        truth->phase[k] = inv->phase[k];
        truth->shunt[k] = switched_inverter_shunt(inv, k);
        truth->amplifier[k] = inv->amplifier[INVERTER_LANE(k)];
    }
}

void switching_bus(const switching_t *plant, switching_bus_t *bus)
{
    switching_t copy = advanced_copy(plant, 0);
    switching_advance_axis(&copy, 1);
    bus->u_dc = copy.supply.u;
    bus->e_source = copy.supply.e_source;
    bus->e_brake = copy.supply.e_brake;
    bus->t_brake = copy.supply.brake_resistor.t;
}
