/* speed_control.h - speed and torque control: i_q* within the limits of motor, bus and speed (DRM 2.5). The
 * three control functions set i_d* in `axis->current_ref`. */
#ifndef SERVO_DRIVE_SPEED_CONTROL_H
#define SERVO_DRIVE_SPEED_CONTROL_H

#include "drive/axis_data.h"

/* Speed control to `motion.speed_ref`. Returns i_q*. */
frac16_t speed_control(axis_t *axis);

/* Gains of a configuration, without reduction. */
const pi_gains_t *speed_control_full_gains(const axis_t *axis, const axis_config_t *config);

/* Full gains, and no oscillation found: the axis is enabled, or its configuration is new. */
void speed_control_start(axis_t *axis);

/* Bumpless change to gains and feed-forward of `config`, before it takes effect, with the
 * bandwidths divided by 2^gain_shift: the integrator compensates the change. */
void speed_control_retune(axis_t *axis, const axis_config_t *config, uint16_t gain_shift);

/* Torque control within the speed limits. Returns i_q*. */
frac16_t torque_control(axis_t *axis);

/* One slow tick of constant current, with bumpless transfer to the speed controller. Returns i_q*. */
frac16_t press_control(axis_t *axis);

#endif
