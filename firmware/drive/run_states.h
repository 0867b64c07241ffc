/* run_states.h - the sub-states of RUN and their transitions (DRM 4.5, F37). */
#ifndef SERVO_DRIVE_RUN_STATES_H
#define SERVO_DRIVE_RUN_STATES_H

#include "drive/axis_data.h"

/* Functions by sub-state and loop. */
extern const axis_function_t run_table[7][6];

/* Call the function of the present sub-state for `loop`; inline, because the fast loop is time-critical. */
static inline void run_state_step(axis_t *axis, axis_loop_t loop) { run_table[axis->substate][loop](axis); }

/* Enter RUN in sub-state CALIB; leave RUN from CALIB and READY only. */
void run_state_enter(axis_t *axis);
bool run_state_may_leave(const axis_t *axis);

#endif
