/* motion.h - from set-points to i_q*: position, speed and torque control of a spinning axis (DRM 2.5..2.7, F26). */
#ifndef SERVO_DRIVE_MOTION_H
#define SERVO_DRIVE_MOTION_H

#include "drive/axis.h"

/* SPIN begins: hold where the shaft is; what was commanded before does not count. */
void motion_start(axis_t *axis);

/* The limits of this tick, which the host may have changed. */
void motion_limit(axis_t *axis, axis_limits_t limits);

/* One slow tick: take fresh commands, shape, run the controllers, set `axis->current_ref`. */
void motion_step(axis_t *axis);

/* True when the speed controller has pushed with all it has for too long and nothing has moved. */
bool motion_stalled(const axis_t *axis);

/* True when the shaft gains speed while it should lose it, against all the current there is or beyond the speed limit: a
 * wrong encoder angle turns the torque round. */
bool motion_runs_away(const axis_t *axis);

/* True once a withdrawn drive has been ramped down, or has taken too long. */
bool motion_stopped(const axis_t *axis);

/* Position that the shaft is meant to have now [counts]. */
int32_t motion_position_ref(const axis_t *axis);

#endif
