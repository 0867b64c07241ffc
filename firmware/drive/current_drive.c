#include "drive/current_drive.h"

void drive_current(axis_t *axis, frac16_t theta_e)
{
    const abc_t current = drive_measured(axis);
    const bool compensates = (axis->features & FEATURE_BUS_COMPENSATION) != 0U;
    const frac16_t u_dc = compensates ? drive_bus(axis) : axis->config->u_dc_nominal;
    drive_apply(axis, current_loop_step(&axis->current_loop, &axis->config->current_loop, current, axis->current_ref,
                                        theta_e, u_dc));
}
