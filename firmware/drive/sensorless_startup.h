/* sensorless_startup.h - start-up from rest to the minimum speed of the observer (ST slides
 * "Start-up strategy", "Criterion of a successful start-up").
 *
 *   CATCH  The current is controlled to zero, and the back-EMF of a rotating shaft is observed.
 *   TRACK  The PLL locks.
 *   PROVE  At zero current, dead time and switch drops can imitate a back-EMF, so i_d is applied; only a true back-EMF
 *          remains.
 *   RAMP   A shaft at rest is accelerated by a current vector of ramped amplitude and frequency. The rotor oscillates
 *          about the vector with little damping; a current in quadrature, proportional to the quadrature back-EMF,
 *          damps it.
 */
#ifndef SERVO_DRIVE_SENSORLESS_STARTUP_H
#define SERVO_DRIVE_SENSORLESS_STARTUP_H

#include "drive/axis_data.h"

typedef enum {
    STARTUP_RUNS, /* in progress */
    STARTUP_DONE, /* the estimate of angle and speed is valid */
    STARTUP_FAILED, /* time-out of the ramp */
} startup_result_t;

/* Begin; `backwards`: negative speed set-point. */
void startup_begin(axis_t *axis, bool backwards);

/* One PWM period: current control in the frame of the present start-up phase (startup_phase_t), and observer. */
void startup_fast(axis_t *axis);

/* One slow tick, after sensorless_estimate_step. */
void startup_step(axis_t *axis);

/* After sensorless_estimate_judge of the same tick: result of the start-up. */
startup_result_t startup_judge(axis_t *axis);

/* Finding of a failed start-up: no current flows, or another reason. */
finding_t startup_failure(const axis_t *axis);

/* Bumpless transfer to control in the rotor frame. */
void startup_hand_over(axis_t *axis);

/* One slow tick in SPIN: ramp i_d* from the value at the hand-over to its remaining value. */
frac16_t startup_reduce_i_d(axis_t *axis);

#endif
