/* stop.h - how an axis comes to rest when its drive is withdrawn: by a command, or by a fault that leaves a choice.
 *
 * A category that the moment does not permit gives way to the next harsher one: hold -> ramp -> short -> coast. What is
 * demanded while a stop is in progress takes over if it is harsher.
 */
#ifndef SERVO_DRIVE_STOP_H
#define SERVO_DRIVE_STOP_H

#include "drive/axis_data.h"

/* Withdraw the drive, or let a stop in progress go on in a harsher way. */
void stop_begin(axis_t *axis, stop_category_t category);

/* The harshest answer to a set of faults. */
stop_category_t stop_for(const stop_config_t *config, fault_set_t faults);

/* True while an axis can still be brought to rest by what drives it. */
bool stop_is_controllable(const axis_t *axis);

/* True if the windings may be shorted at this speed. */
bool stop_may_short(const axis_t *axis);

/* One slow tick of a spinning axis without a drive: how it goes on. STOP_CATEGORY_COAST: outputs off now; STOP_CATEGORY_SHORT: short the
 * windings now; else go on decelerating or holding. */
stop_category_t stop_step(axis_t *axis);

/* One slow tick of shorted windings: true when the short has to end. */
bool stop_short_over(axis_t *axis);

/* True if more current flows in the short than is allowed. */
bool stop_short_overloaded(const axis_t *axis);

#endif
