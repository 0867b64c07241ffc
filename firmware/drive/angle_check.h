/* angle_check.h - checks the encoder angle by the observed back-EMF (FEATURE_ANGLE_CHECK).
 *
 * In the frame of the encoder the back-EMF must be (0, omega psi_m). An offset error rotates it, by 180 degrees if the
 * torque is reversed; a dead encoder gives back-EMF at speed 0. Independent of the lock of the PLL, so the delay is
 * short.
 */
#ifndef SERVO_DRIVE_ANGLE_CHECK_H
#define SERVO_DRIVE_ANGLE_CHECK_H

#include "drive/axis_data.h"

/* Reset at the start of SPIN. */
void angle_check_start(axis_t *axis);

/* One slow tick in SPIN, after the controllers: compare the observed back-EMF. */
void angle_check_step(axis_t *axis);

/* In a later PWM period of the same slow tick: raise FINDING_OBSERVER_ANGLE_MISMATCH. */
void angle_check_judge(axis_t *axis);

#endif
