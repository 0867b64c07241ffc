/* monitors.h - calls the fault monitors of an axis, once per slow tick. */
#ifndef SERVO_DRIVE_MONITORS_H
#define SERVO_DRIVE_MONITORS_H

#include "drive/axis_data.h"

/* Present findings of bus voltage and hardware over-current latch. */
finding_set_t monitor_bus_now(const axis_t *axis);

/* Fast test in every PWM period: true if the bus voltage or the over-current latch may cause a finding, or a fault is
 * captured. */
static inline bool monitor_fault_possible(const axis_t *axis)
{
    return bus_monitor_fault_possible(&axis->diagnosis.bus, axis->u_dc) ||
           hal_over_current_active(axis->hal, axis->index) || axis->latch.captured != 0U;
}

/* Fill the observation; monitors of current measurement, heat sink, winding and phases. Currents, set-points and
 * angle are those of the last period, because the fast loop of this period runs later. */
void monitor_currents(axis_t *axis);

/* Monitors of encoder and angle with the same observation; raises the findings of both functions together, so that the
 * priority table applies to one slow tick. Runs in the next PWM period, because of the computing time. */
void monitor_encoder(axis_t *axis);

#endif
