/* run_step.h - functions of the sub-states in the fast loop. */
#ifndef SERVO_DRIVE_RUN_STEP_H
#define SERVO_DRIVE_RUN_STEP_H

#include "drive/axis_data.h"

/* Call the function of the present sub-state for `loop`. */
void run_state_step(axis_t *axis, axis_loop_t loop);

/* Functions by sub-state and loop (drive/run_states.c). */
extern const axis_function_t run_table[7][6];

void spin_fast(axis_t *axis);
void spin_observed_fast(axis_t *axis);
void spin_test_signal_fast(axis_t *axis);

#endif
