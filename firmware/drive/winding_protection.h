/* winding_protection.h - the winding of an axis: its temperature, and with the feature WINDING_MODEL the current that it bears. */
#ifndef SERVO_DRIVE_WINDING_PROTECTION_H
#define SERVO_DRIVE_WINDING_PROTECTION_H

#include "drive/axis_data.h"

/* As after a reset. */
void winding_protection_init(axis_t *axis);

/* Once per slow tick, in any state: a winding cools down in a fault, too. */
void winding_protection_step(axis_t *axis);

#endif
