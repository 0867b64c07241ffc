/* Changes of the switching plant from outside: parameters and inputs. */
#include <math.h>
#include <string.h>

#include "plant/switching_axis.h"
#include "plant/switching_parameters.h"

static void set_inertia(switching_t *plant, int i)
{
    plant->axis[i].inverter.inv_inertia = plant->axis[i].driven.on ? 0.0 : 1.0 / plant->parameters[i].inertia;
}

static void change_axis(switching_t *plant, int i, const board_config_t *config)
{
    const plant_axis_t *c = &config->axis[i];
    switching_axis_t *axis = &plant->axis[i];
    switched_inverter_t *inv = switching_prepare_change(plant, i);
    const terminal_integral_t before = switched_inverter_integral(inv);
    axis->i_noise = plant_faults_noise(&axis->faults.i_noise_configured, axis->i_noise, c->i_noise);
    thermal_change(&axis->winding, c->winding_capacity, c->winding_resistance);
    thermal_change(&axis->sink, c->sink_capacity, c->sink_resistance);
    switching_apply_axis(plant, i, config);
    switched_inverter_change(inv, c, c->r_s * thermal_copper(&axis->winding));
    set_inertia(plant, i);
    if (c->magnet_coefficient != 0.0) {
        switched_inverter_set_magnet(inv, switching_magnet_flux(plant, i));
    }
    switching_start_slip(plant, i, quadrature_change(&axis->encoder, c, inv->theta));
    const terminal_integral_t after = switched_inverter_integral(inv);
    for (int k = 0; k < 3; k++) { /* a change of the flux that no voltage has made */
        axis->window.volts[k] += after.volts[k] - before.volts[k];
    }
}

void switching_change(switching_t *plant, const board_config_t *config)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        /* NOLINTNEXTLINE(bugprone-suspicious-memory-comparison): a difference in padding only costs time */
        if (memcmp(&plant->parameters[i], &config->axis[i], sizeof plant->parameters[i]) != 0) {
            change_axis(plant, i, config);
        }
    }
    switching_update_other_clock(plant);
    plant->stale = true;
    switching_find_next_event(plant);
    switching_advance_supply(plant);
    switching_apply_bus(plant, &config->bus);
    supply_change(&plant->supply, &config->bus);
}

/* ---- shaft and motor -------------------------------------------------------------------------------------------------- */

void switching_set_load(switching_t *plant, int axis, double torque)
{
    (void)switching_prepare_change(plant, axis);
    switching_apply_load(plant, axis, torque);
}

void switching_set_friction(switching_t *plant, int i, double friction)
{
    if (friction != plant->axis[i].inverter.friction) {
        switching_prepare_change(plant, i)->friction = friction;
    }
}

void switching_lock(switching_t *plant, int axis, bool locked)
{
    switched_inverter_t *inverter = switching_prepare_change(plant, axis);
    inverter->locked = locked;
    inverter->omega = locked ? 0.0 : inverter->omega;
}

void switching_obstruct(switching_t *plant, int axis, double below, double above)
{
    switched_inverter_t *inverter = switching_prepare_change(plant, axis);
    inverter->stop_min = inverter->theta - below;
    inverter->stop_max = inverter->theta + above;
}

void switching_drive_shaft(switching_t *plant, int i, double theta, double omega, double duration)
{
    switched_inverter_t *inverter = switching_prepare_change(plant, i);
    inverter->locked = false;
    inverter->stop_min = -INFINITY;
    inverter->stop_max = INFINITY;
    driven_shaft_begin(&plant->axis[i].driven, inverter->theta, inverter->omega, theta, omega, duration, 0.0);
    set_inertia(plant, i);
    inverter->omega =
        driven_shaft_step(&plant->axis[i].driven, inverter->theta, seconds(plant->now, plant->window_clock));
}

void switching_release_shaft(switching_t *plant, int i)
{
    if (plant->axis[i].driven.on) {
        switching_prepare_change(plant, i)->omega = driven_shaft_speed(&plant->axis[i].driven);
        plant->axis[i].driven.on = false;
        set_inertia(plant, i);
    }
}

/* The resistance follows at the next step of the temperatures. */
void switching_warm_winding(switching_t *plant, int axis, double celsius) { plant->axis[axis].winding.t = celsius; }

void switching_warm_magnet(switching_t *plant, int axis, double celsius) { plant->t_magnet[axis] = celsius; }

void switching_plug(switching_t *plant, int axis, bool plugged)
{
    switched_inverter_plug(switching_prepare_change(plant, axis), plugged);
}

void switching_cut(switching_t *plant, int i, int line, bool cut, bool level)
{
    quadrature_t *encoder = &plant->axis[i].encoder;
    switching_pass_deferred(plant, i);
    const bool before = quadrature_level(encoder, line);
    encoder->cut[line] = cut;
    encoder->stuck[line] = level;
    switching_update_line(plant, i, line, before);
}

/* ---- bus -------------------------------------------------------------------------------------------------------------- */

void switching_set_supply(switching_t *plant, double volts)
{
    switching_find_next_event(plant);
    switching_advance_supply(plant);
    supply_set(&plant->supply, volts);
}

void switching_brake_resistor(switching_t *plant, bool on)
{
    switching_find_next_event(plant);
    switching_advance_supply(plant);
    supply_switch(&plant->supply, on);
}
