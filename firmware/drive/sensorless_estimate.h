/* sensorless_estimate.h - back-EMF observer and PLL of an axis: sensorless feedback, or check of the encoder angle. */
#ifndef SERVO_DRIVE_SENSORLESS_ESTIMATE_H
#define SERVO_DRIVE_SENSORLESS_ESTIMATE_H

#include "drive/axis_data.h"

/* Start with the rotor at `angle`, rotating by `step` per PWM period. */
void sensorless_estimate_start(axis_t *axis, uint32_t angle, int32_t step);
void sensorless_estimate_stop(axis_t *axis);

/* Set the PLL to a known angle and speed. */
void sensorless_estimate_set_angle(axis_t *axis, uint32_t angle, int32_t step);

/* Once per slow tick, at equal intervals: rotation of the angle since the last call. */
void sensorless_estimate_update_rotation(axis_t *axis);

/* Once per slow tick: back-EMF, speed, and deviation. The caller then sets the speed of the observer. */
void sensorless_estimate_step(axis_t *axis);

/* Once per slow tick, after sensorless_estimate_step: reliability of the estimate. */
void sensorless_estimate_judge(axis_t *axis);

/* Clear the filters and counters of the reliability checks. */
void sensorless_estimate_clear_checks(axis_t *axis);

/* Expected back-EMF at a mechanical speed, Q1.15 of full-scale voltage. */
frac16_t sensorless_estimate_emf_at(const axis_t *axis, frac32_t speed);

/* One slow tick: count and return the consecutive slow ticks with a speed below half of the minimum observable speed or
 * with the wrong sign. A reversal includes a standstill, so it counts as standstill. This also detects a blocked rotor
 * that oscillates, whose PLL would otherwise keep running. */
uint16_t sensorless_estimate_count_standstill(axis_t *axis);

#endif
