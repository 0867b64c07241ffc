/* set_position.h - assigns a new value to the present position, without motion. */
#ifndef SERVO_DRIVE_SET_POSITION_H
#define SERVO_DRIVE_SET_POSITION_H

#include "drive/axis_data.h"

/* True at rest outside SPIN and ALIGN, or in position hold without a trajectory. */
bool set_position_permitted(const axis_t *axis);

/* Add a number of position counts to all position variables. */
void set_position_shift(axis_t *axis, int32_t counts);

#endif
