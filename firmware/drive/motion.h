/* motion.h - from set-points to i_q*: position, speed and torque control of a spinning axis (DRM 2.5..2.7, F26). */
#ifndef SERVO_DRIVE_MOTION_H
#define SERVO_DRIVE_MOTION_H

#include "drive/axis_data.h"

/* SPIN begins: hold where the shaft is; what was commanded before does not count. */
void motion_start(axis_t *axis);

/* SPIN begins with a shaft that turns, and with the current that flows: the speed set-point holds. */
void motion_start_turning(axis_t *axis, frac16_t i_q);

/* Sensorless, every slow tick outside SPIN: take a speed set-point, flag what cannot be done. */
void motion_accept_speed(axis_t *axis);

/* Mode TEST: a speed set-point that is too old is zero. */
void motion_expire_speed(axis_t *axis);

/* Sensorless: the speed set-point, within its limits; 0 while nothing is to turn, or below the observer's minimum. */
frac32_t motion_wanted_speed(const axis_t *axis);

/* Sensorless, in SPIN: set-point or shaft are below the observer's minimum speed. */
bool motion_too_slow(const axis_t *axis);

/* One slow tick: take fresh commands, shape, run the controllers, set `axis->current_ref`. */
void motion_step(axis_t *axis);

/* Turn at a speed until another motion is asked for; within the limits, which are renewed when that begins. */
void motion_home(axis_t *axis, frac32_t speed);

/* Push with a current. A speed controller would chatter there: the M/T method shows every count of dither as a speed. */
void motion_press(axis_t *axis, frac16_t i_q);

/* A trajectory ends in a stop: a limit switch is in its way. */
void motion_leave_path(axis_t *axis);

/* End what these two have begun: to rest, then hold. */
void motion_rest(axis_t *axis);

/* May points be queued? The axis is in mode TRAJECTORY, and holds or follows a trajectory. */
bool motion_takes_points(const axis_t *axis);

/* Once per slow tick, after the slow loop: work out where a trajectory is at the next slow tick, which is `tick`. */
void motion_plan(axis_t *axis, uint32_t tick);

/* True once a withdrawn drive has been ramped down, or has taken too long. */
bool motion_stopped(const axis_t *axis);

/* Position that the shaft is meant to have now [counts]. */
int32_t motion_position_ref(const axis_t *axis);

/* Once per slow tick, after motion_step: distance from the shaft to its ideal model [counts]; 0 unless a position is
 * followed. */
int32_t motion_following_error(axis_t *axis);

#endif
