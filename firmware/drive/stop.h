/* stop.h - stop categories for disable, quick stop and faults.
 *
 * A category that is not possible is replaced by the next harsher one: hold -> ramp -> short -> coast. During a stop
 * only a harsher category is accepted.
 */
#ifndef SERVO_DRIVE_STOP_H
#define SERVO_DRIVE_STOP_H

#include "drive/axis_data.h"

/* Withdraw the enable and begin a stop, or change a stop in progress to a harsher category. */
void stop_begin(axis_t *axis, stop_category_t category);

/* Harshest category configured for a set of faults. */
stop_category_t stop_for(const stop_config_t *config, fault_set_t faults);

/* True while the shaft can be decelerated by current control or shorted windings. */
bool stop_is_controllable(const axis_t *axis);

/* True if the windings may be shorted at this speed. */
bool stop_may_short(const axis_t *axis);

/* One slow tick of a stop in SPIN. Returns STOP_CATEGORY_COAST: outputs off now; STOP_CATEGORY_SHORT: short the
 * windings now; otherwise: continue the deceleration or position hold. */
stop_category_t stop_step(axis_t *axis);

/* One slow tick of shorted windings: true if the short must end. */
bool stop_short_over(axis_t *axis);

/* True if the current of the shorted windings exceeds its limit. */
bool stop_short_overloaded(const axis_t *axis);

#endif
