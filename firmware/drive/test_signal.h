/* test_signal.h - test signals added to a set-point, for the measurement of control loops and motor
 * (doc/test-signals.md). */
#ifndef SERVO_DRIVE_TEST_SIGNAL_H
#define SERVO_DRIVE_TEST_SIGNAL_H

#include "drive/axis_data.h"

/* Add the signal to the set-point at `point`, from the next slow tick on. Ends with the last sample of the sine, or
 * with the motion: change of sub-state, stop, fault. */
void test_signal_start(axis_t *axis, uint16_t point, const swept_sine_t *sine);

/* Once per slow tick, between two slow loops: signals at slow points, end of all signals. */
void test_signal_step(axis_t *axis);

/* One PWM period of current control with the signal on i_d* or i_q*. */
void test_signal_drive(axis_t *axis, frac16_t theta_e);

#endif
