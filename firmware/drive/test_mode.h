/* test_mode.h - sub-state TEST: current vector at an imposed angle, for the identification of an unknown motor. */
#ifndef SERVO_DRIVE_TEST_MODE_H
#define SERVO_DRIVE_TEST_MODE_H

#include "drive/axis_data.h"

/* True if mode TEST is requested and permitted: the axis has an encoder (to observe the motion) and no holding brake
 * (an imposed vector cannot hold its load). */
bool test_mode_requested(const axis_t *axis);

/* Begin with zero current at angle 0. */
void test_mode_start(axis_t *axis);

/* One PWM period, without and with a test signal. */
void test_mode_fast(axis_t *axis);
void test_mode_signal_fast(axis_t *axis);

/* One slow tick: ramp current and speed of the vector to their set-points. */
void test_mode_slow(axis_t *axis);

/* Angle of the vector in the last period. */
frac16_t test_mode_angle(const axis_t *axis);

#endif
