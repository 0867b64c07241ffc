/* axis.h - one motor: its state machines, feedback, controllers, limits and faults (DRM 4.4, 4.5).
 *
 * The same code drives every axis; what differs is in the axis_config_t. The application calls axis_slow and axis_fast
 * at the instants of DRM F34 and hands on the commands that it has latched for the tick.
 */
#ifndef SERVO_DRIVE_AXIS_H
#define SERVO_DRIVE_AXIS_H

#include "drive/axis_faults.h"

/* `record` and `clock` belong to the caller and live as long as the axis. */
void axis_init(axis_t *axis, const axis_config_t *config, hal_t *hal, uint16_t index, fault_record_t *record,
               const uint32_t *clock);

/* Every PWM period, after the conversions of this axis. */
void axis_fast(axis_t *axis);

/* Once per slow tick, in any period: what no set-point of the current waits for. Offsets of the currents, and the
 * estimate of the observer. */
void axis_estimate(axis_t *axis);

/* In a later period than axis_estimate, before the next slow tick: is the estimate reliable, does the motion obey? New
 * limits of the path are taken in here. */
void axis_check(axis_t *axis);

/* Once per slow tick, but in other periods than axis_slow, one right after the other: is everything as it should be? */
void axis_monitor_currents(axis_t *axis);
void axis_monitor_encoder(axis_t *axis);

/* Once per slow tick, before the next one, which is `tick`: where is a trajectory then? */
void axis_plan(axis_t *axis, uint32_t tick);

/* Once per slow tick, in a period of its own: what protects the motor and can wait a tick. */
void axis_protect(axis_t *axis);

/* Test signals. */
void axis_test_signal(axis_t *axis);

/* Every slow tick; `axis->command` and `axis->limits` hold what is valid for this tick. */
void axis_slow(axis_t *axis);

/* Edge and break interrupts. */
void axis_edge(axis_t *axis);
void axis_over_current_trip(axis_t *axis);

#endif
