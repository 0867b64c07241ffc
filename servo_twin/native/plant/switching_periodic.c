#include "plant/switching_periodic.h"

#include "plant/switching_axis.h"
#include "plant/switching_parameters.h"

#define THERMAL_WINDOWS 16u /* windows per step of the temperatures */

/* Update all temperatures, and the resistances and fluxes that follow them. */
static void update_temperatures(switching_t *plant)
{
    const double h = (double)(THERMAL_WINDOWS * plant->window) * CLOCK;
    for (int i = 0; i < BOARD_AXES; i++) {
        switching_axis_t *axis = &plant->axis[i];
        switched_inverter_t *inv = &axis->inverter;
        switched_inverter_sync(inv);
        plant->stale = true;
        thermal_advance(&axis->winding, h, inv->e_copper - axis->e_copper);
        if (!axis->faults.sink_held) {
            thermal_advance(&axis->sink, h, inv->e_switch - axis->e_switch);
        }
        axis->e_copper = inv->e_copper;
        axis->e_switch = inv->e_switch;
        switched_inverter_set_winding(inv, axis->r_s * thermal_copper(&axis->winding));
        plant->t_magnet[i] +=
            thermal_magnet(h, plant->parameters[i].magnet_time) * (axis->winding.t - plant->t_magnet[i]);
        if (plant->parameters[i].magnet_coefficient != 0.0) {
            switched_inverter_set_magnet(inv, switching_magnet_flux(plant, i));
            inv->trajectory_changed = true;
        }
    }
    supply_warm(&plant->supply, h);
}

/* The shaft of an axis moves otherwise than extrapolated. */
static switched_inverter_t *change_motion(switching_t *plant, int i)
{
    switched_inverter_t *inv = &plant->axis[i].inverter;
    switched_inverter_sync(inv);
    inv->segment_valid = false;
    inv->trajectory_changed = true;
    plant->stale = true;
    return inv;
}

/* Mean speed of a driven shaft in the next window. */
static void move_driven_shaft(switching_t *plant, int i)
{
    switched_inverter_t *inv = change_motion(plant, i);
    inv->omega = driven_shaft_step(&plant->axis[i].driven, inv->theta, (double)plant->window * CLOCK);
}

/* Update the torque of end stops, shaft and cogging on a rotor. */
static void update_load(switching_t *plant, int i)
{
    switched_inverter_t *inv = change_motion(plant, i);
    inv->load = end_stop_load(&plant->stop[i], inv->theta, inv->omega);
    if (plant->shaft[i].fine) {
        inv->load += shaft_step(&plant->shaft[i], inv->theta, inv->omega, SHAFT_STEP);
    }
}

void switching_step_shafts(switching_t *plant)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        if (plant->shaft[i].fine) {
            switching_advance_axis(plant, i);
            update_load(plant, i);
        }
    }
    plant->shaft_clock += SWITCHING_SHAFT;
}

void switching_end_window(switching_t *plant)
{
    const double per_h = SWITCHING_CLOCK_HZ / (double)plant->window;
    for (int i = 0; i < BOARD_AXES; i++) {
        switching_axis_t *axis = &plant->axis[i];
        switching_advance_axis(plant, i);
        plant->too_fast =
            plant->too_fast || shaft_too_fast(axis->inverter.omega, axis->inverter.theta + axis->inverter.phase[0]);
        const terminal_integral_t now = switched_inverter_integral(&axis->inverter);
        for (int k = 0; k < 3; k++) {
            axis->voltage[k] = (now.volts[k] - axis->window.volts[k]) * per_h;
        }
        if (plant->axis[i].driven.on) {
            move_driven_shaft(plant, i);
        } else if (plant->stop[i].stiffness > 0.0 && !plant->shaft[i].fine) {
            update_load(plant, i);
        }
    }
    if (++plant->windows == THERMAL_WINDOWS) {
        plant->windows = 0;
        update_temperatures(plant);
    }
    for (int i = 0; i < BOARD_AXES; i++) { /* with the new resistance */
        plant->axis[i].window = switched_inverter_integral(&plant->axis[i].inverter);
    }
    plant->window_clock += plant->window;
}
