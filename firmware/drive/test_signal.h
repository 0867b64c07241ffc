/* test_signal.h - test signals: added to a set-point while the axis runs, to measure loops and motor. */
#ifndef SERVO_DRIVE_TEST_SIGNAL_H
#define SERVO_DRIVE_TEST_SIGNAL_H

#include "drive/axis_data.h"

/* From the next slow tick on, on top of the set-point at this point. It ends by itself, and with everything that ends the
 * motion: another sub-state, a stop, a fault. */
void test_signal_start(axis_t *axis, uint16_t point, const swept_sine_t *sine);

/* Once per slow tick, between two slow loops: signals of slow points, and the end of all. */
void test_signal_step(axis_t *axis);

/* One current control of the fast loop, with the signal on i_d* or i_q*. */
void test_signal_drive(axis_t *axis, frac16_t theta_e);

#endif
