/* sensorless_estimate.h - observer and PLL of an axis, whatever they are used for: its feedback, or the check of its encoder. */
#ifndef SERVO_DRIVE_SENSORLESS_ESTIMATE_H
#define SERVO_DRIVE_SENSORLESS_ESTIMATE_H

#include "drive/axis_data.h"

/* From rest, with the rotor assumed at `angle`, turning by `step` per period. */
void sensorless_estimate_start(axis_t *axis, uint32_t angle, int32_t step);
void sensorless_estimate_stop(axis_t *axis);

/* The PLL goes on from an angle known from elsewhere. */
void sensorless_estimate_set_angle(axis_t *axis, uint32_t angle, int32_t step);

/* Once per slow tick, at equal distances: how far the angle has gone since the last call. */
void sensorless_estimate_update_rotation(axis_t *axis);

/* Once per slow tick: what the back-EMF says of it. The observer is yet to be told how fast the rotor turns. */
void sensorless_estimate_step(axis_t *axis);

/* Once per slow tick, some time after that: is the estimate reliable? */
void sensorless_estimate_judge(axis_t *axis);

/* What was found so far says nothing of what comes. */
void sensorless_estimate_clear_checks(axis_t *axis);

/* Back-EMF, as in the last slow tick, that belongs to a speed. */
frac16_t sensorless_estimate_emf_at(const axis_t *axis, frac32_t speed);

/* Slow ticks in a row in which the shaft has been too slow to be observed, or has turned the other way, which it cannot
 * without standing in between: a model of it would go on for ever, with one that swings where it is held, too. */
uint16_t sensorless_estimate_standstill_ticks(axis_t *axis);

#endif
