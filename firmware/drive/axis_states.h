/* axis_states.h - the states and their transitions (DRM 4.5, F36). */
#ifndef SERVO_DRIVE_AXIS_STATES_H
#define SERVO_DRIVE_AXIS_STATES_H

#include "drive/axis_data.h"

/* Enter INIT with everything off. */
void axis_states_init(axis_t *axis);

#endif
