/* run_step.h - functions of the sub-state SPIN in the fast loop, apart from the other sub-states because a port may place
 * them in faster memory. */
#ifndef SERVO_DRIVE_RUN_STEP_H
#define SERVO_DRIVE_RUN_STEP_H

#include "drive/axis_data.h"

void spin_fast(axis_t *axis);
void spin_observed_fast(axis_t *axis);
void spin_test_signal_fast(axis_t *axis);

#endif
