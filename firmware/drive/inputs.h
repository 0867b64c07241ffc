/* inputs.h - home switch, limit switches and enable input of an axis.
 *
 * Pins that are not fitted are ignored. An active limit switch acts as a soft limit at the present position, in every
 * mode.
 */
#ifndef SERVO_DRIVE_INPUTS_H
#define SERVO_DRIVE_INPUTS_H

#include "drive/axis_data.h"

#define INPUT_LIMITS (INPUT_LIMIT_MIN | INPUT_LIMIT_MAX)

/* Apply the configuration of the pins, at rest. */
void inputs_configure(axis_t *axis);

/* One slow tick: read and filter the inputs, raise findings. */
void inputs_step(axis_t *axis);

/* False while the enable input is open, or both limit switches are active. */
bool inputs_permit(const axis_t *axis);

#endif
