/* inputs.h - home switch, limit switches and enable input of an axis.
 *
 * Of the pins that are not fitted nothing is read. An active limit switch is a limit of the position where the shaft is: the
 * same code that keeps the shaft within its soft limits keeps it off the switch, in every mode.
 */
#ifndef SERVO_DRIVE_INPUTS_H
#define SERVO_DRIVE_INPUTS_H

#include "drive/axis_data.h"

#define INPUT_LIMITS (INPUT_LIMIT_MIN | INPUT_LIMIT_MAX)

/* The configuration has changed, at rest. */
void inputs_configure(axis_t *axis);

/* One slow tick: read and filter the inputs; raises what stops the axis. */
void inputs_step(axis_t *axis);

/* False while the enable input is open, or both limit switches say that there is no way to go. */
bool inputs_permit(const axis_t *axis);

#endif
