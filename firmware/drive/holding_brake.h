/* holding_brake.h - the brake that holds the shaft while the drive does not: closed without current.
 *
 * It opens when there is torque, and closes before the torque goes; where the outputs go off at once, it closes at once. An
 * axis without one has a brake that is always open.
 */
#ifndef SERVO_DRIVE_HOLDING_BRAKE_H
#define SERVO_DRIVE_HOLDING_BRAKE_H

#include "drive/axis_data.h"

static inline bool holding_brake_fitted(const axis_t *axis)
{
    return (axis->config->pins.fitted & INPUT_BRAKE_OPEN) != 0U;
}

/* True once it holds nothing. */
static inline bool holding_brake_is_open(const axis_t *axis)
{
    return !holding_brake_fitted(axis) || (axis->brake.powered && axis->brake.ticks == 0U);
}

/* True once it holds. */
static inline bool holding_brake_is_closed(const axis_t *axis)
{
    return !axis->brake.powered && axis->brake.ticks == 0U;
}

/* True if a stop ends with the position held until the brake has closed: without an encoder there is none to hold. */
static inline bool holding_brake_takes_over(const axis_t *axis)
{
    return holding_brake_fitted(axis) && !axis->sensorless;
}

/* Ask for it; it takes its time. */
static inline void holding_brake_request(axis_t *axis, bool open) { axis->brake.open_requested = open; }

/* One slow tick. */
void holding_brake_step(axis_t *axis);

#endif
