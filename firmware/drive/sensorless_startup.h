/* sensorless_startup.h - from rest to a speed at which the observer works (ST slides "起动策略", "起动成功的判据").
 *
 * First the windings are kept without current: the back-EMF of a shaft that turns shows then, and it is caught as it is.
 * But dead time and drops keep a current away that is meant to flow, so what seems to be back-EMF may be the echo of the
 * voltage that holds it off. A current along the rotor tells: with it echoes end.
 * A shaft that rests is drawn along by a current vector whose length and frequency follow ramps. The rotor swings about
 * the vector like a pendulum with hardly any friction; the back-EMF across the vector tells how fast, and a current across
 * it takes the swing away.
 */
#ifndef SERVO_DRIVE_SENSORLESS_STARTUP_H
#define SERVO_DRIVE_SENSORLESS_STARTUP_H

#include "drive/axis_data.h"

typedef enum {
    STARTUP_RUNS,
    STARTUP_DONE, /* the observer has the rotor */
    STARTUP_FAILED,
} startup_result_t;

/* Begin in the direction of a set-point. */
void startup_begin(axis_t *axis, bool backwards);

/* One PWM period: the current loop in its frame, and the observer. */
void startup_fast(axis_t *axis);

/* One slow tick, after sensorless_estimate_step. */
void startup_step(axis_t *axis);

/* After sensorless_estimate_judge of the same tick: is the observer reliable? */
startup_result_t startup_judge(axis_t *axis);

/* A start-up that has failed: because no current flows, or for another reason. */
finding_t startup_failure(const axis_t *axis);

/* The rotor is taken over from the vector: currents and voltages stay what they are. */
void startup_hand_over(axis_t *axis);

/* What is left of the vector along the rotor, one slow tick later. */
frac16_t startup_fade(axis_t *axis);

#endif
