/* limits.h - which limits hold when, and what the path makes of them. */
#ifndef SERVO_DRIVE_LIMITS_H
#define SERVO_DRIVE_LIMITS_H

#include "drive/axis_data.h"

/* Take the limits as they are written in this tick. A tighter one is in force at once. A wider one waits for the next set-point,
 * mode or stop, as the acceleration does either way: a parameter alone never sets a shaft in motion, and a move that has
 * begun keeps the acceleration that it was planned with. */
void limits_tighten(axis_t *axis);

/* A fresh command takes the limits as they are written. */
void limits_renew(axis_t *axis);

/* Length of a current vector that the motor is made for, or that a host has allowed beyond that. */
frac16_t limits_vector(const axis_t *axis);

/* What limits and winding leave of it. */
void limits_current(axis_t *axis);

/* These, with the limit switches: one that is active forbids to go on, as a soft limit where the shaft is. */
axis_limits_t limits_at_switches(const axis_t *axis, axis_limits_t limits);

/* The path filter and the soft limits follow the limits: for a path that is yet to begin .. */
void limits_settle(axis_t *axis);

/* .. and with one in flight, once after a change. Its divisions are long: in another period than the set-points. */
void limits_retune(axis_t *axis);

#endif
