/* winding_protection.h - winding temperature of an axis, and derating of the current limit (I2t, feature WINDING_MODEL;
 * doc/motor-temperature.md). */
#ifndef SERVO_DRIVE_WINDING_PROTECTION_H
#define SERVO_DRIVE_WINDING_PROTECTION_H

#include "drive/axis_data.h"

/* Initialise as after a reset. */
void winding_protection_init(axis_t *axis);

/* Once per slow tick in every state, because the winding also cools down in state FAULT. */
void winding_protection_step(axis_t *axis);

#endif
