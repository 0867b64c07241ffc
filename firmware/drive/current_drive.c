#include "drive/current_drive.h"

void drive_current(axis_t *axis, frac16_t theta_e)
{
    const abc_t current = drive_measured(axis);
    axis->sense.current = current;
    /* The observer requires the true voltage. */
    const bool compensates = (axis->parameter.features & FEATURE_BUS_COMPENSATION) != 0U || axis->estimate.runs;
    const frac16_t u_dc = compensates ? drive_bus(axis) : axis->config->u_dc_nominal;
    drive_apply(axis, current_loop_step(&axis->current_loop, &axis->config->current_loop, current, axis->current_ref,
                                        theta_e, u_dc));
}

void drive_observed(axis_t *axis, frac16_t theta_e)
{
    const axis_config_t *config = axis->config;
    sensorless_estimate_t *estimate = &axis->estimate;
    drive_current(axis, theta_e);
    back_emf_observer_step(&estimate->observer, &config->observer, axis->current_loop.stator_current,
                           axis->current_loop.stator_voltage);
    if (estimate->locked) {
        pll_step(&estimate->pll, &config->pll, estimate->observer.e);
    } else {
        pll_coast(&estimate->pll);
    }
}
