/* run_states.h - the sub-states of RUN and their transitions (DRM 4.5, F37). */
#ifndef SERVO_DRIVE_RUN_STATES_H
#define SERVO_DRIVE_RUN_STATES_H

#include "drive/axis_data.h"

/* Enter RUN in sub-state CALIB; leave RUN from CALIB and READY only. */
void run_state_enter(axis_t *axis);
bool run_state_may_leave(const axis_t *axis);

#endif
