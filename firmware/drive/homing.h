/* homing.h - what the position of an axis is worth, and how it becomes known (firmware/doc/homing.md).
 *
 * The position is set where the shaft is, or a stop or a switch is looked for. That is a motion like any other: it obeys
 * limits, every other command ends it, and the host has to be there.
 */
#ifndef SERVO_DRIVE_HOMING_H
#define SERVO_DRIVE_HOMING_H

#include "drive/axis_data.h"

void homing_init(axis_t *axis);

/* cmd.home has been written: it is taken with the next homing_step. */
void homing_request(axis_t *axis, uint16_t method, int32_t value);

/* FRESH_ bits of a command with this position that may take effect: a set-point out of reach does not. What moves the
 * shaft in another way ends a homing. */
uint16_t homing_filter(axis_t *axis, uint16_t fresh, int32_t position);

/* Limits as far as homing lets them stand: less current, no soft limits meanwhile; around where the axis was enabled until
 * the position is known. */
void homing_confine(axis_t *axis, axis_limits_t *limits);

/* SPIN begins here. */
void homing_spin(axis_t *axis);

/* The count of the position has been lost. */
void homing_forget(axis_t *axis);

/* Once per slow tick. */
void homing_step(axis_t *axis);

#endif
