#include "drive/motion.h"

#include "drive/holding_brake.h"
#include "drive/limits.h"
#include "drive/path_units.h"
#include "drive/soft_limits.h"
#include "drive/speed_control.h"

#define GAIN_TICKS 256 /* slow ticks: time constant of a change of the position gain */
/* The axis counts as at rest within REST_COUNTS of its target, and until it is more than REST_LEFT off, in multiples of
 * the resolution of the encoder. Below that the integral part of the speed controller would hunt against friction. */
#define REST_COUNTS 1
#define REST_LEFT 2

/* ---- entering a motion ------------------------------------------------------------------------------------------ */

/* Start in steady motion at `speed`: the change of motion itself causes no acceleration feed-forward. */
static void enter(axis_t *axis, motion_t motion, frac32_t speed)
{
    motion_state_t *m = &axis->motion;
    m->motion = motion;
    m->entry_speed = speed;
    m->speed_ramp = speed;
    m->shaped_speed = speed;
    m->acceleration = 0;
    m->resting = false;
    m->limit_hold_current = 0;
    m->stop_ticks = 0;
}

static void begin(axis_t *axis, motion_t motion)
{
    if (axis->motion.motion != motion) {
        limits_renew(axis);
        enter(axis, motion, axis->feedback.speed);
    }
}

/* Steady lag of the shaft behind its position set-point at this speed: the position controller is proportional, so
 * without speed feed-forward it needs an error to command a speed. */
static int32_t lag_of(const axis_t *axis, frac32_t speed)
{
    return axis->motion.path_forward ? 0 : speed / axis->motion.position_gain;
}

static void start_path(axis_t *axis, int32_t target, frac32_t speed)
{
    motion_state_t *m = &axis->motion;
    m->path_forward = (axis->parameter.features & FEATURE_SPEED_FORWARD) != 0U;
    limits_settle(axis);
    path_filter_reset(&m->path, i32_add_wrap(axis->feedback.position, lag_of(axis, speed)),
                      path_step_of(axis->config, speed), axis->path_limits.omega_n_ts);
    m->model_position = path_counts(axis->feedback.position);
    m->target = target;
    m->target_clipped = false;
    enter(axis, MOTION_POSITION, speed);
}

static void hold(axis_t *axis) { start_path(axis, axis->feedback.position, 0); }

/* ---- commands --------------------------------------------------------------------------------------------------- */

/* Modes without a default set-point: the axis comes to rest until one is written. */
static bool mode_holds(uint16_t mode) { return mode != CONTROL_MODE_SPEED && mode != CONTROL_MODE_TORQUE; }

/* A new mode without a set-point brings the axis to rest; torque mode starts at zero current. */
static void take_mode(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const uint16_t mode = axis->command.mode;
    if ((uint16_t)m->motion != mode) {
        m->expired = false;
        m->underrun = false;
        m->speed_target = 0;
        m->i_q_target = 0;
        axis->command.age = 0;
        begin(axis, mode_holds(mode) ? MOTION_STOP : (motion_t)mode);
    }
}

static void take_set_point(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const axis_command_t *command = &axis->command;
    if ((command->fresh & FRESH_MODE) != 0U) {
        take_mode(axis);
    }
    if (!axis_set_point_fresh(command)) {
        return;
    }
    m->expired = false;
    m->underrun = false;
    limits_renew(axis);
    if (command->mode == CONTROL_MODE_TRAJECTORY || command->mode == CONTROL_MODE_TEST) {
        return; /* points wait in their queue; a test begins at rest with the drive off */
    }
    if (command->mode == CONTROL_MODE_SPEED) {
        begin(axis, MOTION_SPEED);
        m->speed_target = command->speed;
    } else if (command->mode == CONTROL_MODE_TORQUE) {
        begin(axis, MOTION_TORQUE);
        m->i_q_target = command->i_q;
    } else if (m->motion == MOTION_POSITION) {
        m->target = command->position;
        m->target_clipped = false;
    } else {
        start_path(axis, command->position, axis->feedback.speed);
        path_filter_start_braking(&m->path, soft_limits_inside(axis, m->target), axis->path_limits.acceleration,
                                  axis->path_limits.omega_n_ts);
    }
}

/* Modes that need an encoder are neither started nor stored on an axis without one. */
static bool impossible(const axis_t *axis) { return axis->sensorless && mode_holds(axis->command.mode); }

/* Speed and torque commands expire: a set-point that is not written again within the timeout ends in a stop. */
static bool expired(const axis_t *axis)
{
    return axis->command_timeout != 0U && axis->command.age >= axis->command_timeout;
}

static void expire(motion_state_t *m)
{
    m->expired = m->expired || m->speed_target != 0 || m->motion == MOTION_TORQUE;
    m->speed_target = 0;
    m->i_q_target = 0;
}

void motion_expire_speed(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    if (expired(axis)) {
        m->expired = m->expired || m->speed_target != 0 || m->i_q_target != 0;
        m->speed_target = 0;
    }
    if (m->expired) {
        axis_report(axis, LIMIT_EXPIRED);
    }
}

/* True if the stop ends with position hold: the axis is enabled, or the stop holds for a time. */
static bool stop_holds(const axis_t *axis)
{
    return axis->enable_requested || axis->stop.category == STOP_CATEGORY_HOLD || holding_brake_takes_over(axis);
}

static void take_stop(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const bool begins =
        (axis->command.fresh & FRESH_QUICK_STOP) != 0U || (!axis->enable_requested && axis->stop.ticks == 0U);
    if (begins || !stop_holds(axis) || m->motion != MOTION_POSITION) {
        begin(axis, MOTION_STOP);
    }
    if (axis->sensorless) {
        m->speed_target = 0;
    }
    m->expired = false;
    m->underrun = false;
}

static void take_commands(axis_t *axis)
{
    const axis_command_t *command = &axis->command;
    motion_state_t *m = &axis->motion;
    if (impossible(axis)) {
        axis_report(axis, LIMIT_SENSORLESS);
        take_stop(axis);
        return;
    }
    if (!axis->enable_requested || command->quick_stop) {
        take_stop(axis);
        return;
    }
    if (command->fresh != 0U) {
        take_set_point(axis);
    }
    if ((m->motion == MOTION_SPEED || m->motion == MOTION_TORQUE) && expired(axis)) {
        expire(m);
        begin(axis, MOTION_STOP);
    }
    if (m->expired) {
        axis_report(axis, LIMIT_EXPIRED);
    }
    if (m->underrun) {
        axis_report(axis, LIMIT_STARVED);
    }
}

/* ---- controllers ------------------------------------------------------------------------------------------------ */

static frac32_t limited_speed(axis_t *axis, frac32_t speed)
{
    const frac32_t limited = f32_clip(speed, axis->limits.speed);
    if (limited != speed) {
        axis_report(axis, LIMIT_SPEED);
    }
    return limited;
}

/* Confine the speed to the soft limits. Not used for a position target, which is within them. */
static frac32_t confined_speed(axis_t *axis, frac32_t speed)
{
    if (!soft_limits_given(axis)) {
        return speed;
    }
    const frac32_t confined = soft_limits_confined(axis, speed);
    if (f32_abs(confined) < axis->limits.speed && confined != speed) {
        axis_report(axis, axis->home.limit);
        return confined;
    }
    return speed;
}

static void confine_target(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    if (!soft_limits_given(axis)) {
        return;
    }
    const int32_t target = soft_limits_target(axis);
    m->target_clipped = m->target_clipped || target != m->target;
    m->target = target;
    if (m->target_clipped) {
        axis_report(axis, axis->home.limit);
    }
}

static void shape(motion_state_t *m, frac32_t speed)
{
    m->acceleration = f32_sub(speed, m->shaped_speed);
    m->shaped_speed = speed;
}

static void follow_path(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const path_position_t before = m->path.output;
    if (m->shaped_speed == 0) {
        m->path_forward = (axis->parameter.features & FEATURE_SPEED_FORWARD) != 0U; /* in motion this would be a step */
    }
    path_filter_step(&m->path, m->target, axis->path_limits.step, axis->path_limits.acceleration,
                     axis->path_limits.omega_n_ts);
    shape(m, path_speed_of(axis->config, m->path.output - before));
}

/* At rest near the target the set-point is 0, unless the integrator still pushes away from the target: then the shaft
 * would creep on, count by count, at the limit of static friction. */
static bool rests(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const int32_t off = i32_sub_wrap(m->target, axis->feedback.position);
    const int32_t max = (m->resting ? REST_LEFT : REST_COUNTS) * axis->encoder.resolution;
    m->resting = off <= max && off >= -max && path_filter_at_rest(&m->path, m->target);
    if (!m->resting) {
        return false;
    }
    const frac32_t held = pi_integral(&m->speed_pi);
    return !((off > 0 && held < 0) || (off < 0 && held > 0));
}

/* Position controller (F26, E42..E45): omega* = K_v (x* - x), plus the speed of the path with speed feed-forward.
 * Proportional only, because no overshoot is allowed. */
static frac32_t requested_speed(const axis_t *axis, path_position_t behind)
{
    const frac32_t behind_q8 = sat32(asr64(behind, PATH_BITS - 8));
    const frac32_t forward = axis->motion.path_forward ? axis->motion.shaped_speed : 0;
    return sat32(forward + asr64((int64_t)behind_q8 * axis->motion.position_gain, 8));
}

/* Limit of the speed: the speed limit, or the speed of the path while that is still decelerating to a lower limit. */
static frac32_t followed_speed(axis_t *axis, path_position_t behind)
{
    const frac32_t speed = requested_speed(axis, behind);
    const frac32_t limited = limited_speed(axis, speed);
    if (limited == speed) {
        return speed;
    }
    const frac32_t shaped = f32_abs(axis->motion.shaped_speed);
    return (shaped > axis->limits.speed) ? f32_clip(speed, shaped) : limited;
}

/* Position of an ideal shaft under the position controller; the difference to the real one is the following error. The
 * steady lag of the position controller is excluded, and so is motion with a current that is reduced by bus, winding or
 * field weakening. */
static void follow_model(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    if ((axis->parameter.features & FEATURE_FOLLOWING_ERROR) == 0U || m->current_reduced) {
        m->model_position = path_counts(axis->feedback.position);
        return;
    }
    const path_position_t behind =
        path_beyond(m->path.output, path_whole(m->model_position)) - path_part(m->model_position);
    m->model_position += path_step_of(axis->config, followed_speed(axis, behind));
}

/* Position error: set-point of the path minus position. */
static path_position_t position_error(const axis_t *axis)
{
    return path_beyond(axis->motion.path.output, axis->feedback.position) - axis->feedback.part;
}

static frac32_t position_controller(axis_t *axis)
{
    confine_target(axis);
    follow_path(axis);
    if (rests(axis)) {
        return 0;
    }
    return followed_speed(axis, position_error(axis));
}

/* ---- trajectories ------------------------------------------------------------------------------------------------ */

/* Motions with a position set-point: a path or a trajectory. */
static bool follows_position(const motion_state_t *m)
{
    return m->motion == MOTION_POSITION || m->motion == MOTION_TRAJECTORY;
}

bool motion_takes_points(const axis_t *axis)
{
    const bool spins = axis->sm.state == STATE_RUN && axis->substate == SUBSTATE_SPIN;
    const bool requested =
        axis->enable_requested && !axis->command.quick_stop && axis->command.mode == CONTROL_MODE_TRAJECTORY;
    const bool free = holding_brake_is_open(axis) && !axis->sensorless;
    return spins && requested && free && follows_position(&axis->motion);
}

void motion_plan(axis_t *axis, uint32_t tick)
{
    trajectory_t *t = &axis->trajectory;
    if (!motion_takes_points(axis)) {
        trajectory_clear(t);
        return;
    }
    if (t->active || trajectory_waiting(t) != 0U) {
        const motion_state_t *m = &axis->motion;
        const hermite_state_t present = {m->path.output, path_step_of(axis->config, m->shaped_speed)};
        trajectory_step(t, axis->config, present, tick);
    }
}

/* After the last point the axis holds its position. */
static void rest_at_end(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    m->target = path_filter_position(&m->path);
    m->target_clipped = false;
    path_filter_reset(&m->path, m->target, 0, axis->path_limits.omega_n_ts);
    enter(axis, MOTION_POSITION, 0);
}

/* The points have run out at a speed other than 0. */
static void stop_after_underrun(axis_t *axis)
{
    enter(axis, MOTION_STOP, axis->motion.shaped_speed);
    axis->motion.underrun = true;
    axis_report(axis, LIMIT_STARVED);
}

static frac32_t trajectory_controller(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    trajectory_t *t = &axis->trajectory;
    const path_position_t before = m->path.output;
    m->path.output = t->reference.position;
    shape(m, path_speed_of(axis->config, m->path.output - before));
    const frac32_t speed = followed_speed(axis, position_error(axis));
    if (t->reference.over) {
        t->active = false;
        if (t->end.speed == 0) {
            rest_at_end(axis);
        } else {
            stop_after_underrun(axis);
        }
    }
    return speed;
}

/* The unsigned difference cannot overflow. */
static frac32_t ramp(frac32_t from, frac32_t to, frac32_t step)
{
    if (to >= from) {
        return ((uint32_t)to - (uint32_t)from > (uint32_t)step) ? from + step : to;
    }
    return ((uint32_t)from - (uint32_t)to > (uint32_t)step) ? from - step : to;
}

/* Slow enough for position hold or for coasting. */
static bool slow(const axis_t *axis) { return f32_abs(axis->feedback.speed) <= axis->config->stop_speed; }

/* At the end of a stop the shaft is at rest, or has reversed between two samples. */
static bool at_rest(const axis_t *axis)
{
    return slow(axis) || (axis->feedback.speed < 0) != (axis->motion.entry_speed < 0);
}

/* Ramp towards the set-point within the limits, or to rest. */
static frac32_t ramped_speed(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const frac32_t step = axis->limits.acceleration;
    frac32_t speed;
    if (m->motion == MOTION_STOP) {
        speed = ramp(m->speed_ramp, 0, step);
    } else {
        const frac32_t requested = ramp(m->speed_ramp, limited_speed(axis, m->speed_target), step);
        speed = ramp(m->speed_ramp, confined_speed(axis, requested), step);
    }
    m->speed_ramp = speed;
    shape(m, speed);
    return speed;
}

static void end_stop(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    if (m->speed_ramp != 0) {
        return;
    }
    if (m->stop_ticks < UINT16_MAX && !m->current_reduced) { /* time with limited regeneration does not count */
        m->stop_ticks++;
    }
    /* With a low current limit the shaft lags the ramp: a position held now would require a motion back to it. */
    if (stop_holds(axis) && at_rest(axis) && !axis->sensorless) {
        hold(axis);
    }
}

void motion_home(axis_t *axis, frac32_t speed)
{
    begin(axis, MOTION_HOME);
    axis->motion.speed_target = speed;
}

void motion_press(axis_t *axis, frac16_t i_q)
{
    begin(axis, MOTION_PRESS);
    axis->motion.i_q_target = i_q;
}

void motion_leave_path(axis_t *axis)
{
    if (axis->motion.motion == MOTION_TRAJECTORY) {
        begin(axis, MOTION_STOP);
    }
}

void motion_rest(axis_t *axis)
{
    if (axis->motion.motion == MOTION_HOME || axis->motion.motion == MOTION_PRESS) {
        begin(axis, MOTION_STOP);
        axis->motion.speed_target = 0;
    }
}

void motion_start(axis_t *axis)
{
    axis->motion = (motion_state_t){.position_gain = axis->config->position_gain};
    axis->diagnosis.shaft = (shaft_monitor_t){0};
    speed_control_start(axis);
    limits_renew(axis);
    hold(axis);
}

void motion_start_turning(axis_t *axis, frac16_t i_q)
{
    motion_state_t *m = &axis->motion;
    pi_reset(&m->speed_pi, f32_from_f16(i_q));
    m->i_q_target = 0;
    m->saturated = false;
    m->target_clipped = false;
    m->speed_ref = axis->feedback.speed;
    axis->diagnosis.shaft = (shaft_monitor_t){0};
    speed_control_start(axis);
    enter(axis, MOTION_SPEED, axis->feedback.speed);
}

void motion_accept_speed(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const axis_command_t *command = &axis->command;
    if (!axis->enable_requested || command->quick_stop || command->mode != CONTROL_MODE_SPEED) {
        m->speed_target = 0;
        m->expired = false;
    } else if ((command->fresh & FRESH_SPEED) != 0U) {
        m->expired = false;
        limits_renew(axis);
        m->speed_target = command->speed;
    } else if (expired(axis)) {
        expire(m);
    }
    if (m->expired) {
        axis_report(axis, LIMIT_EXPIRED);
    }
    const bool unable = command->mode != CONTROL_MODE_SPEED || m->speed_target != 0;
    if (axis->enable_requested && unable && motion_requested_speed(axis) == 0) {
        axis_report(axis, LIMIT_SENSORLESS);
    }
}

frac32_t motion_requested_speed(const axis_t *axis)
{
    const frac32_t min = axis->config->startup.minimum_speed;
    const frac32_t speed = soft_limits_confined(axis, axis->motion.speed_target);
    return (speed < min && speed > -min) ? 0 : speed;
}

bool motion_too_slow(const axis_t *axis)
{
    const frac32_t commanded = (axis->motion.motion == MOTION_TORQUE) ? axis->feedback.speed : axis->motion.speed_ramp;
    return f32_abs(commanded) < axis->config->startup.minimum_speed;
}

/* Another gain comes into force slowly: the speed set-point that the lag of a moving shaft gives must not jump. */
static void follow_gain(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const int32_t change = m->position_gain_target - m->position_gain;
    if (change != 0) {
        const int32_t part = change / GAIN_TICKS;
        m->position_gain += (part != 0) ? part : change;
    }
}

/* Speed set-point plus test signal; the limits apply to the sum. */
static frac32_t speed_with_test_signal(axis_t *axis)
{
    const frac32_t speed = f32_add(axis->motion.speed_ref, axis->motion.speed_test_signal);
    return confined_speed(axis, limited_speed(axis, speed));
}

void motion_step(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    take_commands(axis);
    follow_gain(axis);
    if (m->motion == MOTION_TORQUE) {
        axis->current_ref.q = torque_control(axis);
        return;
    }
    if (m->motion == MOTION_POSITION && axis->trajectory.active) {
        m->path_forward = true;
        m->motion = MOTION_TRAJECTORY;
    }
    if (m->motion == MOTION_TRAJECTORY) {
        m->speed_ref = trajectory_controller(axis);
    } else if (m->motion == MOTION_POSITION) {
        m->speed_ref = position_controller(axis);
    } else if (m->motion == MOTION_PRESS) {
        axis->current_ref.q = press_control(axis);
        return;
    } else {
        m->speed_ref = ramped_speed(axis);
        if (m->motion == MOTION_STOP) {
            end_stop(axis);
        }
    }
    if (m->speed_test_signal != 0) {
        m->speed_ref = speed_with_test_signal(axis);
    }
    axis->current_ref.q = speed_control(axis);
}

bool motion_stopped(const axis_t *axis)
{
    const motion_state_t *m = &axis->motion;
    return m->motion == MOTION_STOP && m->speed_ramp == 0 &&
           (slow(axis) || m->stop_ticks >= axis->config->stop_ticks_max);
}

int32_t motion_position_ref(const axis_t *axis)
{
    return follows_position(&axis->motion) ? path_filter_position(&axis->motion.path) : axis->feedback.position;
}

int32_t motion_following_error(axis_t *axis)
{
    if (!follows_position(&axis->motion)) {
        return 0;
    }
    follow_model(axis);
    return i32_sub_wrap(path_whole(axis->motion.model_position), axis->feedback.position);
}
