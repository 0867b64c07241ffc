/* motion.h - position, speed and torque control in SPIN: set-points to i_q* (DRM 2.5..2.7, F26). */
#ifndef SERVO_DRIVE_MOTION_H
#define SERVO_DRIVE_MOTION_H

#include "drive/axis_data.h"

/* Start of SPIN: position hold; earlier set-points are discarded. */
void motion_start(axis_t *axis);

/* Start of SPIN with a rotating shaft and the current `i_q`: keep the speed set-point. */
void motion_start_turning(axis_t *axis, frac16_t i_q);

/* Sensorless, every slow tick outside SPIN: accept a speed set-point, report commands that are not possible. */
void motion_accept_speed(axis_t *axis);

/* Mode TEST: set an expired speed set-point to zero. */
void motion_expire_speed(axis_t *axis);

/* Sensorless: limited speed set-point; 0 without a set-point, or below the minimum speed of the observer. */
frac32_t motion_requested_speed(const axis_t *axis);

/* Sensorless, in SPIN: set-point or shaft are below the minimum speed of the observer. */
bool motion_too_slow(const axis_t *axis);

/* One slow tick: take new commands, shape the set-points, run the controllers, set `axis->current_ref`. */
void motion_step(axis_t *axis);

/* Homing: rotate at a constant speed, within the limits. Applies the written limits at its start. */
void motion_home(axis_t *axis, frac32_t speed);

/* Homing: constant current against a stop. A speed controller would chatter, because the M/T method converts every
 * count of dither to a speed. */
void motion_press(axis_t *axis, frac16_t i_q);

/* Limit switch reached: end a trajectory with a stop. */
void motion_leave_path(axis_t *axis);

/* End motion_home or motion_press: ramp to rest, then position hold. */
void motion_rest(axis_t *axis);

/* True if points may be queued: mode TRAJECTORY, in position hold or on a trajectory. */
bool motion_takes_points(const axis_t *axis);

/* Once per slow tick, after the slow loop: compute the trajectory at the next slow tick, `tick`. */
void motion_plan(axis_t *axis, uint32_t tick);

/* True when the ramp after a disable is complete or has timed out. */
bool motion_stopped(const axis_t *axis);

/* Position set-point [counts]: output of the path, otherwise the present position. */
int32_t motion_position_ref(const axis_t *axis);

/* Once per slow tick, after motion_step: following error [counts], relative to an ideal shaft; 0 without a position
 * set-point. */
int32_t motion_following_error(axis_t *axis);

#endif
