/* set_position.h - another number for the place where the shaft is. */
#ifndef SERVO_DRIVE_SET_POSITION_H
#define SERVO_DRIVE_SET_POSITION_H

#include "drive/axis_data.h"

/* Nothing is on its way to a position: the shaft rests with its outputs off, or is held by a drive without a trajectory. */
bool set_position_permitted(const axis_t *axis);

/* Add `counts` to all that counts positions; nothing moves. */
void set_position_shift(axis_t *axis, int32_t counts);

#endif
