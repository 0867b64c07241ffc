/* holding_brake.h - spring-applied holding brake (closed without current).
 *
 * Opens after torque has been built up, closes before it is removed; closes immediately if the outputs are switched off
 * immediately. Without a fitted brake it counts as open.
 */
#ifndef SERVO_DRIVE_HOLDING_BRAKE_H
#define SERVO_DRIVE_HOLDING_BRAKE_H

#include "drive/axis_data.h"

static inline bool holding_brake_fitted(const axis_t *axis)
{
    return (axis->config->pins.fitted & INPUT_BRAKE_OPEN) != 0U;
}

/* True if the brake is open, or not fitted. */
static inline bool holding_brake_is_open(const axis_t *axis)
{
    return !holding_brake_fitted(axis) || (axis->brake.powered && axis->brake.ticks == 0U);
}

/* True if the brake is closed. Only for axes with a fitted brake. */
static inline bool holding_brake_is_closed(const axis_t *axis)
{
    return !axis->brake.powered && axis->brake.ticks == 0U;
}

/* True if a stop ends with position hold until the brake is closed. An axis without an encoder cannot hold a
 * position. */
static inline bool holding_brake_takes_over(const axis_t *axis)
{
    return holding_brake_fitted(axis) && !axis->sensorless;
}

/* Request opening or closing; done after open_ticks or close_ticks. */
static inline void holding_brake_request(axis_t *axis, bool open) { axis->brake.open_requested = open; }

/* One slow tick: switch the coil, measure the load. */
void holding_brake_step(axis_t *axis);

#endif
