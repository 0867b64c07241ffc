/* limits.h - applies written limits, and computes current and path limits from them. */
#ifndef SERVO_DRIVE_LIMITS_H
#define SERVO_DRIVE_LIMITS_H

#include "drive/axis_data.h"

/* Apply the limits written in this tick. Tighter limits apply immediately; wider limits, and any new acceleration,
 * with the next set-point, mode change or stop: a parameter never causes motion, and a motion in progress keeps its
 * acceleration. */
void limits_tighten(axis_t *axis);

/* Apply all written limits, with a new command. */
void limits_renew(axis_t *axis);

/* Largest length of the current vector: limit of the configuration, or param.i_q_limit if that is higher. */
frac16_t limits_vector(const axis_t *axis);

/* Compute the current limits from limits and winding model. */
void limits_current(axis_t *axis);

/* Limits with an additional soft limit at the present position for each active limit switch. */
axis_limits_t limits_at_switches(const axis_t *axis, axis_limits_t limits);

/* Compute the path limits from the limits in force, before a path begins. */
void limits_settle(axis_t *axis);

/* Compute the path limits after a change, and adapt a path in progress. Runs in another PWM period than the set-points,
 * because of its divisions. */
void limits_retune(axis_t *axis);

#endif
