/* axis.h - interface of one axis: state machines, feedback, controllers, limits and faults (DRM 4.4, 4.5).
 *
 * One implementation for all axes; the parameters are in axis_config_t. The application calls axis_slow and axis_fast
 * at the instants of DRM F34, with the commands latched for the tick.
 */
#ifndef SERVO_DRIVE_AXIS_H
#define SERVO_DRIVE_AXIS_H

#include "drive/axis_faults.h"

/* Initialise, outputs off. `config`, `record` and `clock` must stay valid as long as the axis. */
void axis_init(axis_t *axis, const axis_config_t *config, const parameter_block_t *parameter, hal_t *hal,
               uint16_t index, fault_record_t *record, const uint32_t *clock);

/* Fast loop: every PWM period, after the conversions of this axis. */
void axis_fast(axis_t *axis);

/* Once per slow tick, not time-critical: offset tracking of the current measurements, observer. */
void axis_estimate(axis_t *axis);

/* Once per slow tick, after axis_estimate and before the next slow tick: reliability of the estimate, checks of the
 * motion, new limits of the path filter. */
void axis_check(axis_t *axis);

/* Fault monitors: once per slow tick, in two consecutive PWM periods other than that of axis_slow. */
void axis_monitor_currents(axis_t *axis);
void axis_monitor_encoder(axis_t *axis);

/* Once per slow tick: compute the trajectory at the next slow tick, `tick`. */
void axis_plan(axis_t *axis, uint32_t tick);

/* Once per slow tick, in a separate PWM period: pins, holding brake, homing, winding model, field weakening. */
void axis_protect(axis_t *axis);

/* Once per slow tick, two PWM periods before axis_slow: feed-forward against torque ripple. */
void axis_forward(axis_t *axis);

/* Once per slow tick: test signals. */
void axis_test_signal(axis_t *axis);

/* Slow loop: once per slow tick, with `axis->command` latched for this tick. */
void axis_slow(axis_t *axis);

/* Interrupts of the captured encoder edge and of the hardware over-current latch. */
void axis_edge(axis_t *axis);
void axis_over_current_trip(axis_t *axis);

#endif
