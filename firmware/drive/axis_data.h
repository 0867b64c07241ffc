/* axis_data.h - what one motor is: its state machines, feedback, controllers, limits and faults. */
#ifndef SERVO_DRIVE_AXIS_DATA_H
#define SERVO_DRIVE_AXIS_DATA_H

#include "config/axis_config.h"
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

/* What the host has written since the last tick: a set-point or an enable takes effect by being written, never by
 * standing in memory. */
#define FRESH_POSITION UINT16_C(0x01) /* the set-points come in the order of their modes */
#define FRESH_SPEED UINT16_C(0x02)
#define FRESH_I_Q UINT16_C(0x04)
#define FRESH_POINTS UINT16_C(0x08)
#define FRESH_MODE UINT16_C(0x10)
#define FRESH_MOTION UINT16_C(0x1f) /* all of these */
#define FRESH_ENABLE UINT16_C(0x20)
#define FRESH_QUICK_STOP UINT16_C(0x40)
#define FRESH_CLEAR_FAULTS UINT16_C(0x80) /* a 1 */
#define FRESH_HOME UINT16_C(0x100)
#define FRESH_TEST UINT16_C(0x200)

/* Commands of the host to an axis, latched once per slow tick. */
typedef struct {
    int32_t position; /* counts */
    frac32_t speed; /* Q1.31 of full-scale speed */
    frac16_t i_q; /* Q1.15 of full-scale current */
    uint16_t mode; /* control_mode_t */
    bool enable;
    bool quick_stop;
    uint16_t fresh; /* FRESH_ bits */
    uint16_t age; /* slow ticks since a set-point of the mode, or another mode, was written */
} axis_command_t;

/* What happened less than EVENT_TICKS ago: slow ticks to go. */
typedef struct {
    uint16_t command; /* one was latched: from the tick on in which it takes effect */
    uint16_t mode;    /* .. with another mode */
} axis_events_t;

/* A set-point of the mode has just been written. */
static inline bool axis_set_point_fresh(const axis_command_t *command)
{
    if (command->mode == CONTROL_MODE_TEST) {
        return (command->fresh & (FRESH_SPEED | FRESH_I_Q)) != 0U;
    }
    return (command->fresh & (FRESH_POSITION << command->mode)) != 0U;
}

typedef struct {
    frac32_t speed; /* Q1.31 of full-scale speed, without sign */
    frac32_t acceleration; /* speed per slow tick */
    frac16_t i_q; /* Q1.15 of full-scale current, without sign */
    int32_t position_min; /* counts; INT32_MIN, INT32_MAX: none */
    int32_t position_max; /* counts, the same */
} axis_limits_t;

/* What the limit of the current comes to, with what the winding bears now: worked out when either changes. */
typedef struct {
    frac16_t vector;  /* no current vector is longer */
    frac16_t q;       /* limits.i_q, or less */
    frac16_t winding; /* current that the winding bears now; FRAC16_MAX: any */
} current_max_t;

/* The same as the path and the soft limits need them: worked out when they change. */
typedef struct {
    path_position_t step;         /* speed */
    path_position_t acceleration; /* counts per slow tick^2, as `step` */
    path_position_t braking_constant;         /* soft_limits.c */
    uint16_t omega_n_ts;          /* omega_n Ts of the path filter, 16 fraction bits */
    bool stale;                   /* the last two do not fit the limits yet */
} path_limits_t;

/* What the shaft is being made to do while the axis spins. */
typedef enum {
    MOTION_POSITION = CONTROL_MODE_POSITION, /* follow the shaped position set-point */
    MOTION_SPEED = CONTROL_MODE_SPEED,       /* follow the ramped speed set-point */
    MOTION_TORQUE = CONTROL_MODE_TORQUE,     /* follow the current set-point within the speed limit */
    MOTION_TRAJECTORY = CONTROL_MODE_TRAJECTORY, /* follow the curve through timed points */
    MOTION_STOP,                             /* ramp down at the limit; then hold */
    MOTION_HOME,                             /* follow the ramped speed of homing.c */
    MOTION_PRESS,                            /* push with the current of homing.c */
} motion_t;

typedef struct {
    motion_t motion;
    int32_t target;       /* position set-point, counts */
    frac32_t speed_target; /* Q1.31 of full-scale speed */
    frac16_t i_q_target; /* Q1.15 of full-scale current */
    bool target_clipped;  /* a soft limit has taken a part of the set-point */
    bool expired;         /* the axis has stopped because its set-point was not written again */
    bool underrun;         /* .. because no point followed one with a speed */
    path_filter_t path;          /* its output is the position set-point on a trajectory, too */
    path_position_t model_position; /* where the shaft would be if it did what it is told */
    int32_t position_gain; /* in force: on its way to that of the configuration */
    bool path_forward;    /* the path's speed goes straight to the speed controller */
    bool resting;         /* the shaft is close enough to a target that does not move */
    frac32_t speed_ramp; /* output of the ramp, Q1.31 of full-scale speed */
    frac32_t shaped_speed; /* of the path, or the ramp, in this tick */
    frac32_t acceleration; /* change of the shaped speed in this tick */
    pi_state_t speed_pi;
    frac32_t speed_ref; /* set-point of the speed controller, Q1.31 of full-scale speed */
    frac32_t speed_test_signal; /* test signal in it */
    bool saturated;       /* the speed controller pushes with all it has */
    bool current_reduced; /* bus or winding allow less current than controller and limits */
    frac32_t limit_hold_current; /* torque mode: what holds a load that drives the shaft past a limit */
    frac32_t entry_speed; /* at which this motion has begun */
    uint16_t stop_ticks;  /* slow ticks since the ramp of MOTION_STOP has ended */
} motion_state_t;

typedef struct axis {
    const axis_config_t *config;
    hal_t *hal;
    uint16_t index; /* 0, 1: axis1, axis2 */

    sm_t sm;
    substate_t substate;
    axis_loop_t fast; /* variant of the fast loop: LOOP_FAST, LOOP_OBSERVED or LOOP_TEST_SIGNAL */

    axis_command_t command;
    axis_events_t events;
    axis_limits_t limits;         /* in force */
    axis_limits_t written_limits; /* in force with the next command */
    bool limits_fresh;            /* .. where they are tighter, with the next slow tick */
    path_limits_t path_limits;    /* of those in force */
    current_max_t current_max;    /* the same */
    int32_t following_error_max;      /* that is a fault, counts */
    frac32_t over_speed_max;          /* that is a fault */
    uint16_t command_timeout;     /* age at which a speed or torque set-point expires, slow ticks; 0: never */
    uint16_t features;      /* FEATURE_ bits: parts of the control that are on */
    bool enable_requested;         /* the drive is wanted: enable was written and nothing has withdrawn it */
    stop_category_t on_disable, on_quick_stop;
    stop_t stop;            /* how the shaft comes to rest when it is not */
    bool shorted;           /* FREEWHEEL with all low sides on */
    fault_set_t stop_faults; /* captured faults that lead to FAULT once the shaft has been brought to rest */
    fault_latch_t latch;
    uint16_t active_limits; /* LIMIT_ bits of the last slow tick */
    uint16_t ticks;         /* slow ticks in this state */

    const feedback_source_t *source;
    encoder_feedback_t encoder;
    observer_feedback_t observed_position;
    uint16_t feedback_requested; /* feedback_kind_t; taken when the axis is not in RUN */
    bool sensorless;          /* the source is the observer */
    sensorless_estimate_t estimate;
    startup_t startup;
    bool switching_off;          /* sensorless: on the way out of SPIN, below the minimum speed */
    frac16_t last_i_q_ref;  /* i_q* of the last slow tick */
    feedback_t feedback;

    current_sense_t sense;
    frac32_t u_dc_now;    /* bus voltage of this period */
    frac32_t u_dc_filter; /* state of the filter, Q1.31 of the full-scale bus voltage */
    frac16_t u_dc; /* filtered bus voltage */
    frac16_t regen_derating; /* part of the braking current that the bus takes */
    uint16_t bus_limits; /* LIMIT_ bits that stand: of the bus, of the field, and of a set-point that was refused */
    uint16_t input_limits; /* .. those of the inputs */
    uint16_t inputs; /* INPUT_ bits: of the pins that are fitted */
    inputs_state_t inputs_state;
    holding_brake_t brake;
    bool aligned; /* the angle found by the last search still holds */
    bool calibrated;
    rotor_search_t search;
    current_loop_t current_loop;
    dq_t current_ref; /* Q1.15 of full-scale current */
    field_weakening_t weakening; /* of the field; all zero: no effect */
    motion_state_t motion;
    trajectory_t trajectory;
    home_t home;
    observation_t observation;
    diagnosis_t diagnosis;
    dq_t test_current; /* of a monitor or a test signal, added to the set-point */
    test_signal_t test_signal;
} axis_t;

/* LIMIT_ bits of this slow tick. */
static inline void axis_report(axis_t *axis, uint16_t limit)
{
    axis->active_limits = (uint16_t)(axis->active_limits | limit);
}

/* The observer can be used with this motor. */
static inline bool axis_observable(const axis_t *axis) { return axis->config->observer.drive != 0; }

#endif
