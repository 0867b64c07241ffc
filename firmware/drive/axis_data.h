/* axis_data.h - data of one axis: state machines, feedback, controllers, limits and faults. */
#ifndef SERVO_DRIVE_AXIS_DATA_H
#define SERVO_DRIVE_AXIS_DATA_H

#include "config/parameters_gen.h"
#include "control/field_weakening.h"
#include "control/path_filter.h"
#include "diagnosis/diagnosis.h"
#include "diagnosis/fault_latch.h"
#include "drive/current_sense.h"
#include "drive/feedback_data.h"
#include "drive/home_data.h"
#include "drive/inputs_data.h"
#include "drive/sensorless_estimate_data.h"
#include "drive/sensorless_startup_data.h"
#include "drive/state_machine.h"
#include "drive/stop_data.h"
#include "drive/test_signal_data.h"
#include "drive/trajectory.h"
#include "hal/hal.h"

/* PWM periods per slow tick (DRM 2.3.2). */
#define AXIS_SLOW_PERIODS 8

/* Variables written by the host since the last slow tick. A set-point or an enable takes effect only when it is
 * written. */
#define FRESH_POSITION UINT16_C(0x01) /* set-points: bit order of the control modes */
#define FRESH_SPEED UINT16_C(0x02)
#define FRESH_I_Q UINT16_C(0x04)
#define FRESH_POINTS UINT16_C(0x08)
#define FRESH_MODE UINT16_C(0x10)
#define FRESH_MOTION UINT16_C(0x1f) /* all bits above */
#define FRESH_ENABLE UINT16_C(0x20)
#define FRESH_QUICK_STOP UINT16_C(0x40)
#define FRESH_CLEAR_FAULTS UINT16_C(0x80) /* a 1 was written */
#define FRESH_HOME UINT16_C(0x100)
#define FRESH_TEST UINT16_C(0x200)

/* Commands of the host to an axis, latched once per slow tick. */
typedef struct {
    int32_t position; /* counts */
    frac32_t speed; /* Q1.31 of full-scale speed */
    frac16_t i_q; /* Q1.15 of full-scale current */
    uint16_t mode; /* control_mode_t */
    bool enable; /* last written value */
    bool quick_stop; /* last written value */
    uint16_t fresh; /* FRESH_ bits */
    uint16_t age; /* slow ticks since a set-point of the mode, or a new mode, was written */
} axis_command_t;

/* Remaining slow ticks, of EVENT_TICKS, for which an event stays visible to a recorder. */
typedef struct {
    uint16_t command; /* remaining slow ticks since a command took effect */
    uint16_t mode; /* remaining slow ticks since a command with a new mode took effect */
} axis_events_t;

/* True if a set-point of the present mode was written in this tick. */
static inline bool axis_set_point_fresh(const axis_command_t *command)
{
    if (command->mode == CONTROL_MODE_TEST) {
        return (command->fresh & (FRESH_SPEED | FRESH_I_Q)) != 0U;
    }
    return (command->fresh & (FRESH_POSITION << command->mode)) != 0U;
}

typedef struct {
    frac32_t speed; /* Q1.31 of full-scale speed, magnitude */
    frac32_t acceleration; /* speed change per slow tick, Q1.31 of full-scale speed */
    frac16_t i_q; /* Q1.15 of full-scale current, magnitude */
    int32_t position_min; /* counts; INT32_MIN: no limit */
    int32_t position_max; /* counts; INT32_MAX: no limit */
} axis_limits_t;

/* Current limits including the derating of the winding; computed when one of the two changes. */
typedef struct {
    frac16_t vector; /* largest length of the current vector, Q1.15 of full-scale current */
    frac16_t q; /* largest i_q, at most limits.i_q, Q1.15 of full-scale current */
    frac16_t winding; /* permitted current of the winding at its temperature; FRAC16_MAX: no limit */
} current_max_t;

/* Limits in units of the path filter and the soft limits; computed when the limits change. */
typedef struct {
    path_position_t step; /* speed, counts with 24 fraction bits per slow tick */
    path_position_t acceleration; /* counts with 24 fraction bits per slow tick^2 */
    path_position_t braking_constant; /* a / (2 k^2) in soft_limits.c, counts with 24 fraction bits */
    uint16_t omega_n_ts; /* omega_n Ts of the path filter, 16 fraction bits */
    bool stale; /* `braking_constant` and `omega_n_ts` must be recalculated */
} path_limits_t;

/* Feed-forward against torque ripple (ripple_forward.h). */
typedef struct {
    int32_t turn; /* position at the start of the present turn, counts */
    frac32_t current; /* i_q of the next slow tick, Q1.31 of full-scale current */
    frac32_t applied; /* part of `current` that the limit of i_q* has left in the last slow tick */
    uint16_t fade; /* part of the harmonics in force, 15 fraction bits: switched on and off without a step */
    uint16_t limit; /* LIMIT_ bit: why there is no feed-forward */
} ripple_forward_t;

/* Motion in SPIN. */
typedef enum {
    MOTION_POSITION = CONTROL_MODE_POSITION, /* follow the shaped position set-point */
    MOTION_SPEED = CONTROL_MODE_SPEED,       /* follow the ramped speed set-point */
    MOTION_TORQUE = CONTROL_MODE_TORQUE,     /* follow the current set-point within the speed limit */
    MOTION_TRAJECTORY = CONTROL_MODE_TRAJECTORY, /* follow the interpolated timed points */
    MOTION_STOP,                             /* ramp down at the acceleration limit, then position hold */
    MOTION_HOME,                             /* homing: follow a ramped speed */
    MOTION_PRESS,                            /* homing: constant current against a stop */
} motion_t;

typedef struct {
    motion_t motion;
    int32_t target;       /* position set-point, counts */
    frac32_t speed_target; /* Q1.31 of full-scale speed */
    frac16_t i_q_target; /* Q1.15 of full-scale current */
    bool target_clipped; /* a soft limit has reduced the set-point */
    bool expired; /* stopped because the set-point was not written again within the time-out */
    bool underrun; /* stopped because no point followed a point with a speed other than 0 */
    path_filter_t path; /* path filter; on a trajectory only its output is used */
    path_position_t model_position; /* ideal shaft, for the following error, counts with 24 fraction bits */
    int32_t position_gain; /* gain in force, approaches `position_gain_target`: speed fraction (31 bits) per count */
    int32_t position_gain_target; /* that of the configuration, divided by 2^gain_shift */
    bool path_forward; /* speed feed-forward from the path */
    bool resting; /* the shaft is at rest near the target */
    frac32_t speed_ramp; /* output of the ramp, Q1.31 of full-scale speed */
    frac32_t shaped_speed; /* speed of the path or of the ramp in this tick, Q1.31 of full-scale speed */
    frac32_t acceleration; /* change of the shaped speed in this tick, Q1.31 of full-scale speed */
    pi_state_t speed_pi;
    const pi_gains_t *speed_gains; /* gains in force: those of the configuration, or `reduced_gains` */
    pi_gains_t reduced_gains; /* with the bandwidth divided by 2^gain_shift */
    uint16_t gain_shift; /* against an oscillation: bandwidths of speed and position control divided by 2^gain_shift */
    bool forced; /* an oscillation since the start that the gains did not change: the load forces it */
    uint16_t first_swing; /* of the first oscillation since the start, peak to peak, Q1.15 of full-scale current */
    frac32_t speed_ref; /* set-point of the speed controller, Q1.31 of full-scale speed */
    frac32_t speed_test_signal; /* test signal added to `speed_ref`, Q1.31 of full-scale speed */
    bool saturated; /* the output of the speed controller is at its limit */
    bool current_reduced; /* bus, field weakening or winding reduce the current limit below the requested current */
    frac32_t limit_hold_current; /* torque mode: integrator against a load that drives past a speed or soft limit */
    frac32_t entry_speed; /* speed at the start of this motion, Q1.31 of full-scale speed */
    uint16_t stop_ticks; /* slow ticks since the end of the ramp of MOTION_STOP */
} motion_state_t;

typedef struct axis {
    const axis_config_t *config;
    hal_t *hal;
    uint16_t index; /* 0, 1: axis1, axis2 */

    sm_t sm;
    substate_t substate; /* sub-state of STATE_RUN */
    axis_loop_t fast; /* variant of the fast loop: LOOP_FAST, LOOP_OBSERVED or LOOP_TEST_SIGNAL */

    axis_command_t command;
    axis_events_t events;
    axis_parameters_t parameter; /* the latched parameters */
    axis_limits_t limits; /* limits in force */
    axis_limits_t written_limits; /* last written limits: in force with the next command */
    bool limits_fresh; /* written since the last slow tick: tighter limits take effect with the next one */
    path_limits_t path_limits; /* from `limits` */
    current_max_t current_max; /* from `limits` and the winding model */
    uint16_t command_timeout; /* age at which a speed or torque set-point expires, slow ticks; 0: never */
    bool enable_requested; /* enable was written and not withdrawn since */
    stop_t stop; /* stop in progress after the enable was withdrawn */
    bool shorted; /* FREEWHEEL with all low sides on */
    fault_set_t stop_faults; /* captured faults whose stop is in progress; state FAULT follows at rest */
    fault_latch_t latch;
    uint16_t active_limits; /* LIMIT_ bits of the last slow tick */
    uint16_t ticks; /* slow ticks in this state */

    const feedback_source_t *source;
    encoder_feedback_t encoder;
    observer_feedback_t observed_position;
    bool sensorless; /* the feedback source is the observer */
    sensorless_estimate_t estimate;
    startup_t startup;
    bool switching_off; /* sensorless: leaving SPIN, below the minimum speed */
    frac16_t last_i_q_ref; /* i_q* of the last slow tick, Q1.15 of full-scale current */
    feedback_t feedback;

    current_sense_t sense;
    frac32_t u_dc_now; /* bus voltage of this period, Q1.31 of full-scale bus voltage */
    frac32_t u_dc_filter; /* state of the filter, Q1.31 of full-scale bus voltage */
    frac16_t u_dc; /* filtered bus voltage, Q1.15 of full-scale bus voltage */
    frac16_t regen_derating; /* permitted part of the regenerative braking current, Q1.15 */
    uint16_t bus_limits; /* LIMIT_ bits of brake resistor, field weakening, and a refused set-point */
    uint16_t input_limits; /* LIMIT_ bits of the inputs */
    uint16_t inputs; /* INPUT_ bits of the fitted pins */
    inputs_state_t inputs_state;
    holding_brake_t brake;
    bool aligned; /* the rotor angle of the last search is still valid */
    bool calibrated; /* current offsets are measured */
    rotor_search_t search;
    current_loop_t current_loop;
    dq_t current_ref; /* Q1.15 of full-scale current */
    field_weakening_t weakening; /* field weakening; all zero: no effect */
    motion_state_t motion;
    ripple_forward_t ripple;
    trajectory_t trajectory;
    home_t home;
    observation_t observation;
    diagnosis_t diagnosis;
    dq_t test_current; /* current of a monitor or a test signal, added to the set-point, Q1.15 of full-scale current */
    test_signal_t test_signal;
} axis_t;

/* Report LIMIT_ bits in this slow tick. */
static inline void axis_report(axis_t *axis, uint16_t limit)
{
    axis->active_limits = (uint16_t)(axis->active_limits | limit);
}

/* True if the configuration has observer constants for this motor. */
static inline bool axis_observable(const axis_t *axis) { return axis->config->observer.drive != 0; }

/* True if it has constants of the speed observer. */
static inline bool axis_has_speed_observer(const axis_t *axis) { return axis->config->speed_observer.l_position != 0; }

#endif
