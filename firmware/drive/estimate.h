/* estimate.h - observer and PLL of an axis, whatever they are used for: its feedback, or the check of its encoder. */
#ifndef SERVO_DRIVE_ESTIMATE_H
#define SERVO_DRIVE_ESTIMATE_H

#include "drive/axis_data.h"

/* From rest, with the rotor assumed at `angle`, turning by `step` per period. */
void estimate_start(axis_t *axis, uint32_t angle, int32_t step);
void estimate_stop(axis_t *axis);

/* The PLL goes on from an angle known from elsewhere. */
void estimate_set(axis_t *axis, uint32_t angle, int32_t step);

/* Once per slow tick, at equal distances: how far the angle has gone since the last call. */
void estimate_turn(axis_t *axis);

/* Once per slow tick: what the back-EMF says of it. The observer is yet to be told how fast the rotor turns. */
void estimate_step(axis_t *axis);

/* Once per slow tick, some time after that: is the estimate reliable? */
void estimate_judge(axis_t *axis);

/* What was found so far says nothing of what comes. */
void estimate_forget(axis_t *axis);

/* Back-EMF, as in the last slow tick, that belongs to a speed. */
frac16_t estimate_emf_at(const axis_t *axis, frac32_t speed);

/* Slow ticks in a row in which the shaft has been too slow to be observed, or has turned the other way, which it cannot
 * without standing in between: a model of it would go on for ever, with one that swings where it is held, too. */
uint16_t estimate_standing(axis_t *axis);

#endif
