/* speed_control.h - i_q* within what motor, bus and speed limits allow (DRM 2.5). Both leave i_d* in `axis->current_ref`. */
#ifndef SERVO_DRIVE_SPEED_CONTROL_H
#define SERVO_DRIVE_SPEED_CONTROL_H

#include "drive/axis_data.h"

/* Towards `motion.speed_ref`. */
frac16_t speed_control(axis_t *axis);

/* The torque that is wanted, within the speed limits. */
frac16_t torque_control(axis_t *axis);

#endif
