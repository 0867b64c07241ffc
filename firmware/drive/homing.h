/* homing.h - validity of the position, and homing (firmware/doc/homing.md).
 *
 * Methods: set the present position, or search for a hard stop or a home switch. The search obeys the limits; any other
 * command ends it; HOST_SILENT stays active.
 */
#ifndef SERVO_DRIVE_HOMING_H
#define SERVO_DRIVE_HOMING_H

#include "drive/axis_data.h"

void homing_init(axis_t *axis);

/* cmd.home was written: take the request with the next homing_step. */
void homing_request(axis_t *axis, uint16_t method, int32_t value);

/* End a homing if a motion command was written. Remove a position set-point beyond home.reach from the FRESH_ bits of
 * an axis that is not homed. */
uint16_t homing_filter(axis_t *axis, uint16_t fresh, int32_t position);

/* Modify the limits. During homing: reduced current, no soft limits; not homed: home.reach around the position at
 * enabling. */
void homing_confine(axis_t *axis, axis_limits_t *limits);

/* Start of SPIN at the present position. */
void homing_spin(axis_t *axis);

/* The encoder count is invalid: the position is not known any more. */
void homing_forget(axis_t *axis);

/* One slow tick. */
void homing_step(axis_t *axis);

#endif
