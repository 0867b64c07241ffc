#include "drive/current_drive.h"

void drive_observed(axis_t *axis, frac16_t theta_e)
{
    const axis_config_t *config = axis->config;
    estimate_t *estimate = &axis->estimate;
    const current_loop_out_t out = current_loop_run(&axis->current_loop, &config->current_loop, drive_measured(axis),
                                                    axis->current_ref, theta_e, drive_bus(axis));
    drive_apply(axis, out.svm);
    observer_step(&estimate->observer, &config->observer, out.current, out.voltage);
    if (estimate->locked) {
        pll_step(&estimate->pll, &config->pll, estimate->observer.e);
    } else {
        pll_coast(&estimate->pll);
    }
}
