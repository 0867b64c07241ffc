/* test_mode.h - sub-state TEST: a current vector along an imposed angle, for a motor of which nothing is known yet. */
#ifndef SERVO_DRIVE_TEST_MODE_H
#define SERVO_DRIVE_TEST_MODE_H

#include "drive/axis_data.h"

/* The axis is asked to run in control mode TEST, and can: with an encoder, which tells what becomes of it, and without a
 * holding brake, whose load a vector at a wrong angle does not hold. */
bool test_mode_wanted(const axis_t *axis);

/* No current, angle 0. */
void test_mode_start(axis_t *axis);

/* In every period. */
void test_mode_fast(axis_t *axis);
void test_mode_signal_fast(axis_t *axis);

/* Once per slow tick: current and speed of the vector towards their set-points. */
void test_mode_slow(axis_t *axis);

/* The vector of the last period. */
frac16_t test_mode_angle(const axis_t *axis);

#endif
