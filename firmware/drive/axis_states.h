/* axis_states.h - the states and sub-states of one axis and their transitions (DRM 4.5, F36, F37). */
#ifndef SERVO_DRIVE_AXIS_STATES_H
#define SERVO_DRIVE_AXIS_STATES_H

#include "drive/axis.h"

/* Enter INIT with everything off. */
void axis_states_init(axis_t *axis);

/* The table of RUN's sub-states (run_states.c). */
void run_state_step(axis_t *axis);

/* RUN begins in CALIB; RUN may be left from CALIB and READY only. */
void run_state_enter(axis_t *axis);
bool run_state_may_leave(const axis_t *axis);

/* Duty 50 % on every phase, outputs on or off; controllers forget what they held. */
void axis_zero_voltage(axis_t *axis, bool outputs_on);

/* Duty 0 on every phase, outputs on: all low sides short the windings, and the shunts see their currents. */
void axis_short(axis_t *axis);

#endif
