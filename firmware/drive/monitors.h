/* monitors.h - the monitors of an axis, one after the other, once per slow tick. */
#ifndef SERVO_DRIVE_MONITORS_H
#define SERVO_DRIVE_MONITORS_H

#include "drive/axis_data.h"

/* Findings of bus and hardware break that are there now. */
finding_set_t monitor_bus_now(const axis_t *axis);

/* Are bus and break as they should be? In every PWM period: says only whether it is worth looking. */
static inline bool monitor_fault_possible(const axis_t *axis)
{
    return bus_monitor_fault_possible(&axis->diagnosis.bus, axis->u_dc) ||
           hal_over_current_active(axis->hal, axis->index) || axis->latch.captured != 0U;
}

/* Observe, and let the monitors of converters, heat and phases look. Currents, set-points and angle belong to the last
 * period: the fast loop of this one comes afterwards. */
void monitor_currents(axis_t *axis);

/* Let the monitors of encoder and angle look at the same, and raise what all of them have found: the priority table
 * decides among findings of one slow tick. In the next period, as both together take too long. */
void monitor_encoder(axis_t *axis);

#endif
