/* speed_control.h - i_q* within what motor, bus and speed limits allow (DRM 2.5). Both leave i_d* in `axis->current_ref`. */
#ifndef SERVO_DRIVE_SPEED_CONTROL_H
#define SERVO_DRIVE_SPEED_CONTROL_H

#include "drive/axis_data.h"

/* Towards `motion.speed_ref`. */
frac16_t speed_control(axis_t *axis);

/* Gains and feed-forwards of `config`, which is not in force yet, without a step of the current set-point: the integral
 * part takes what they would change. */
void speed_control_retune(axis_t *axis, const axis_config_t *config);

/* The torque that is wanted, within the speed limits. */
frac16_t torque_control(axis_t *axis);

/* One slow tick of a constant current i_q, from which the speed controller goes on afterwards. */
frac16_t press_control(axis_t *axis);

#endif
