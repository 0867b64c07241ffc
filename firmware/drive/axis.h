/* axis.h - one motor: its state machines, feedback, controllers, limits and faults (DRM 4.4, 4.5).
 *
 * The same code drives every axis; what differs is in the axis_config_t. The application calls axis_slow and axis_fast
 * at the instants of DRM F34 and hands on the commands that it has latched for the tick.
 */
#ifndef SERVO_DRIVE_AXIS_H
#define SERVO_DRIVE_AXIS_H

#include "config/axis_config.h"
#include "control/path.h"
#include "drive/angle_watch.h"
#include "drive/current_sense.h"
#include "drive/encoder_watch.h"
#include "drive/estimate.h"
#include "drive/faults.h"
#include "drive/feedback.h"
#include "drive/heat_watch.h"
#include "drive/phase_watch.h"
#include "drive/stall_proof.h"
#include "drive/startup.h"
#include "drive/state_machine.h"
#include "drive/stop.h"
#include "drive/supervision.h"
#include "hal/hal.h"

/* PWM periods per slow tick (DRM 2.3.2). */
#define AXIS_SLOW_PERIODS 8

typedef enum {
    LOOP_FAST,
    LOOP_SLOW,
    LOOP_OBSERVED, /* the fast loop with the observer in it */
} axis_loop_t;

/* What the host asks of an axis, latched once per slow tick. The `fresh_` marks tell what was written since the last
 * tick: a set-point or an enable takes effect by being written, never by standing in memory. */
typedef struct {
    int32_t position; /* counts */
    frac32_t speed;
    frac16_t i_q;
    uint16_t mode; /* control_mode_t */
    bool enable;
    bool quick_stop;
    bool clear_faults;
    bool fresh_position;
    bool fresh_speed;
    bool fresh_i_q;
    bool fresh_mode;
    bool fresh_enable;
    bool fresh_quick_stop;
    bool clipped; /* a set-point had to be clipped */
} axis_command_t;

typedef struct {
    frac32_t speed;
    frac32_t acceleration; /* speed per slow tick */
    frac16_t i_q;
    int32_t position_min; /* counts */
    int32_t position_max; /* counts */
    int32_t following_error; /* counts */
    frac32_t over_speed;
} axis_limits_t;

/* What the shaft is being made to do while the axis spins. */
typedef enum {
    MOTION_POSITION, /* follow the shaped position set-point */
    MOTION_SPEED,    /* follow the ramped speed set-point */
    MOTION_TORQUE,   /* follow the current set-point within the speed limit */
    MOTION_STOP,     /* ramp down at the limit; then hold */
} motion_t;

typedef struct {
    motion_t motion;
    int32_t target;       /* position set-point, counts */
    frac32_t speed_target;
    frac16_t i_q_target;
    bool target_clipped;  /* a soft limit has taken a part of the set-point */
    path_t path;
    path_position_t model; /* where the shaft would be if it did what it is told */
    bool path_forward;    /* the path's speed goes straight to the speed controller */
    bool resting;         /* the shaft is close enough to a target that does not move */
    frac32_t speed_ramp;
    frac32_t shaped_speed; /* of the path, or the ramp, in this tick */
    frac32_t acceleration; /* change of the shaped speed in this tick */
    pi_state_t speed_pi;
    frac32_t speed_ref;
    bool saturated;       /* the speed controller pushes with all it has */
    bool held_back;       /* the bus bears less braking current than the controller wants */
    frac32_t resistance;  /* torque mode: what holds a load that drives the shaft past a limit */
    frac32_t stopping;    /* speed at which MOTION_STOP has begun */
    uint16_t stop_ticks;  /* slow ticks since the ramp of MOTION_STOP has ended */
} motion_state_t;

typedef struct axis {
    const axis_config_t *config;
    hal_t *hal;
    uint16_t index;

    sm_t sm;
    substate_t substate;
    axis_loop_t loop; /* which of a sub-state's functions runs */
    axis_loop_t fast; /* .. in the fast loop */

    axis_command_t command;
    axis_limits_t limits;
    uint16_t features;      /* FEATURE_ bits: parts of the control that are on */
    bool requested;         /* the drive is wanted: enable was written and nothing has withdrawn it */
    stop_category_t on_disable, on_quick_stop;
    stop_t stop;            /* how the shaft comes to rest when it is not */
    bool shorted;           /* FREEWHEEL with all low sides on */
    fault_set_t stop_faults; /* captured faults that lead to FAULT once the shaft has been brought to rest */
    fault_set_t faults;     /* captured faults */
    fault_set_t faults_enabled; /* that may stop the axis; FAULTS_ALWAYS are among them */
    uint16_t first_fault;   /* code of the fault that came first, 0 without one */
    uint16_t active_limits; /* LIMIT_ bits of the last slow tick */
    uint16_t ticks;         /* slow ticks in this state */

    const feedback_source_t *source;
    encoder_feedback_t encoder;
    observer_feedback_t observed_position;
    uint16_t feedback_wanted; /* feedback_kind_t; taken when the axis is not in RUN */
    bool sensorless;          /* the source is the observer */
    estimate_t estimate;
    startup_t startup;
    bool leaving;             /* sensorless: on the way out of SPIN, below the minimum speed */
    frac16_t current_q_left;  /* i_q* of the last slow tick */
    feedback_t feedback;

    current_sense_t sense;
    frac32_t u_dc_now;    /* bus voltage of this period */
    frac32_t u_dc_filter;
    frac16_t u_dc; /* filtered bus voltage */
    frac16_t u_dc_most; /* over-voltage, as long as the brake resistor is as it is */
    frac16_t bearable; /* part of the braking current that the bus bears */
    uint16_t bus_limits; /* LIMIT_ bits that the bus sets on every axis */
    bool calibrated;
    rotor_search_t search;
    stall_proof_t proof;
    current_loop_t current_loop;
    dq_t current_ref;
    motion_state_t motion;
    supervision_t supervision;
    phase_watch_t phases;
    encoder_watch_t encoder_watch;
    angle_watch_t angle_watch;
    heat_watch_t heat;
    fault_record_t *record; /* of the first fault; the owner's */
    const uint32_t *clock;  /* PWM periods since reset; the owner's */
    uint16_t path_omega_n_ts; /* omega_n Ts of the path filter under the present limits, 16 fraction bits */
} axis_t;

/* `record` and `clock` belong to the caller and live as long as the axis. */
void axis_init(axis_t *axis, const axis_config_t *config, hal_t *hal, uint16_t index, fault_record_t *record,
               const uint32_t *clock);

/* Every PWM period, after the conversions of this axis. */
void axis_fast(axis_t *axis);

/* Once per slow tick, but in another period than axis_slow: is everything as it should be? */
void axis_watch(axis_t *axis);

/* Every slow tick; `axis->command` and `axis->limits` hold what is valid for this tick. */
void axis_slow(axis_t *axis);

/* Edge and break interrupts. */
void axis_edge(axis_t *axis);
void axis_break(axis_t *axis);

/* Capture faults. The outputs go off with the next call of the state machine, or after a stop where the configuration has
 * one for all of these faults (stop.h). */
void axis_raise(axis_t *axis, fault_set_t faults);

/* `fault`, or `other` where nobody wants to know of it. */
static inline fault_set_t axis_fault_or(const axis_t *axis, fault_set_t fault, fault_set_t other)
{
    return ((axis->faults_enabled & fault) != 0U) ? fault : other;
}

/* The observer can be used with this motor. */
bool axis_observable(const axis_t *axis);

/* The same as axis_raise, for what concerns an axis only while its drive is wanted (host silence). */
void axis_stop_with(axis_t *axis, fault_set_t faults);

#endif
