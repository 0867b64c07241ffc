/* angle_check.h - the observer beside an encoder: is the rotor where the encoder says? (FEATURE_ANGLE_CHECK)
 *
 * The back-EMF is looked at in the encoder's frame, where it has to be (0, omega psi_m): an offset that is wrong turns it,
 * half a turn of offset, which reverses the torque, turns it round, and with a dead encoder it comes out of nowhere. No
 * PLL has to lock, so it shows as soon as there is enough of it.
 */
#ifndef SERVO_DRIVE_ANGLE_CHECK_H
#define SERVO_DRIVE_ANGLE_CHECK_H

#include "drive/axis_data.h"

/* SPIN begins. */
void angle_check_start(axis_t *axis);

/* One slow tick in SPIN, after the controllers: the output of the observer. */
void angle_check_step(axis_t *axis);

/* Some time after that: raises FINDING_OBSERVER_ANGLE_MISMATCH. */
void angle_check_judge(axis_t *axis);

#endif
