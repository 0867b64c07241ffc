/* outputs.h - inverter outputs without current control. */
#ifndef SERVO_DRIVE_OUTPUTS_H
#define SERVO_DRIVE_OUTPUTS_H

#include "drive/axis_data.h"

/* Duty 50 % on every phase, outputs on or off; controllers are reset. */
void axis_zero_voltage(axis_t *axis, bool outputs_on);

/* Duty 0 on every phase, outputs on: the low sides short the windings, their currents flow through the shunts. */
void axis_short(axis_t *axis);

#endif
