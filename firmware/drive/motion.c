#include "drive/motion.h"

#include "drive/path_units.h"
#include "drive/soft_limits.h"

/* A shaft that comes to rest this close to its target is left alone until it is farther off than that. Closer than the
 * encoder can tell, the integral part of the speed controller would hunt against the friction for ever. */
#define REST_COUNTS 1
#define REST_LEFT 2

/* ---- conversions ------------------------------------------------------------------------------------------------ */

/* How far the shaft trails its position set-point at this speed: the position controller is a plain gain, which
 * needs an error to ask for speed, unless the speed is fed forward. */
static int32_t lag_of(const axis_t *axis, frac32_t speed)
{
    return axis->motion.path_forward ? 0 : speed / axis->config->position_gain;
}

/* E40 asks for accelerations up to omega_n v / e: with less current, or a higher speed, the filter has to be slower. */
static uint16_t omega_n_ts_under(const axis_config_t *config, axis_limits_t limits)
{
    uint32_t omega = (uint32_t)config->path_omega_n_ts * (uint32_t)limits.i_q / (uint32_t)config->i_q_limit;
    if (limits.speed > config->speed_limit) {
        omega = omega * (uint32_t)(config->speed_limit >> 16) / (uint32_t)(limits.speed >> 16);
    }
    if (omega > config->path_omega_n_ts) {
        return config->path_omega_n_ts;
    }
    return (omega == 0U) ? 1U : (uint16_t)omega;
}

void motion_limit(axis_t *axis, axis_limits_t limits)
{
    if (limits.i_q != axis->limits.i_q || limits.speed != axis->limits.speed) {
        const uint16_t omega = omega_n_ts_under(axis->config, limits);
        if (omega != axis->path_omega_n_ts) {
            path_retune(&axis->motion.path, axis->motion.target, axis->path_omega_n_ts, omega);
            axis->path_omega_n_ts = omega;
        }
    }
    axis->limits = limits;
}

/* ---- entering a motion ------------------------------------------------------------------------------------------ */

/* Steady motion at `speed`: what follows finds no acceleration in the change of motion itself. */
static void enter(axis_t *axis, motion_t motion, frac32_t speed)
{
    axis->motion.motion = motion;
    axis->motion.shaped_speed = speed;
    axis->motion.acceleration = 0;
    axis->motion.resting = false;
    axis->motion.resistance = 0;
}

static void start_path(axis_t *axis, frac32_t speed)
{
    motion_state_t *m = &axis->motion;
    m->path_forward = (axis->features & FEATURE_SPEED_FORWARD) != 0U;
    path_reset(&m->path, i32_add_wrap(axis->feedback.position, lag_of(axis, speed)), path_step_of(axis->config, speed),
               axis->path_omega_n_ts);
    m->model = path_counts(axis->feedback.position);
    enter(axis, MOTION_POSITION, speed);
}

static void enter_position(axis_t *axis)
{
    if (axis->motion.motion != MOTION_POSITION) {
        start_path(axis, axis->feedback.speed);
    }
}

static void enter_speed(axis_t *axis)
{
    if (axis->motion.motion != MOTION_SPEED) {
        axis->motion.speed_ramp = axis->feedback.speed;
        enter(axis, MOTION_SPEED, axis->feedback.speed);
    }
}

static void enter_stop(axis_t *axis)
{
    if (axis->motion.motion != MOTION_STOP) {
        axis->motion.speed_ramp = axis->feedback.speed;
        axis->motion.stop_ticks = 0;
        axis->motion.stopping = axis->feedback.speed;
        enter(axis, MOTION_STOP, axis->feedback.speed);
    }
}

static void hold(axis_t *axis)
{
    start_path(axis, 0);
    axis->motion.target = axis->feedback.position;
    axis->motion.target_clipped = false;
}

static void report(axis_t *axis, uint16_t limit) { axis->active_limits = (uint16_t)(axis->active_limits | limit); }

/* ---- commands --------------------------------------------------------------------------------------------------- */

static bool mode_matches(motion_t motion, uint16_t mode)
{
    return (motion == MOTION_POSITION && mode == CONTROL_MODE_POSITION) ||
           (motion == MOTION_SPEED && mode == CONTROL_MODE_SPEED) ||
           (motion == MOTION_TORQUE && mode == CONTROL_MODE_TORQUE);
}

/* A new mode without a set-point brings the axis to rest, or without current in torque mode. */
static void take_mode(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    if (mode_matches(m->motion, axis->command.mode)) {
        return;
    }
    if (axis->command.mode == CONTROL_MODE_SPEED) {
        m->speed_target = 0;
        enter_speed(axis);
    } else if (axis->command.mode == CONTROL_MODE_TORQUE) {
        m->i_q_target = 0;
        enter(axis, MOTION_TORQUE, axis->feedback.speed);
    } else {
        enter_stop(axis);
    }
}

/* What an axis without an encoder cannot do is neither begun nor remembered. */
static bool impossible(const axis_t *axis) { return axis->sensorless && axis->command.mode == CONTROL_MODE_POSITION; }

/* A stop ends by holding the position: of a drive that is wanted, or for some time. */
static bool stop_holds(const axis_t *axis) { return axis->requested || axis->stop.category == STOP_CATEGORY_HOLD; }

static void take_commands(axis_t *axis)
{
    const axis_command_t *command = &axis->command;
    motion_state_t *m = &axis->motion;
    if (impossible(axis)) {
        report(axis, LIMIT_SENSORLESS);
    }
    if (!axis->requested || command->quick_stop || impossible(axis)) {
        const bool begins = command->fresh_quick_stop || (!axis->requested && axis->stop.ticks == 0U);
        if (begins || !stop_holds(axis) || m->motion != MOTION_POSITION) {
            enter_stop(axis);
        }
        if (axis->sensorless) {
            m->speed_target = 0;
        }
        return;
    }
    if (command->fresh_mode) {
        take_mode(axis);
    }
    if (command->fresh_position && command->mode == CONTROL_MODE_POSITION) {
        enter_position(axis);
        m->target = command->position;
        m->target_clipped = false;
    }
    if (command->fresh_speed && command->mode == CONTROL_MODE_SPEED) {
        enter_speed(axis);
        m->speed_target = command->speed;
    }
    if (command->fresh_i_q && command->mode == CONTROL_MODE_TORQUE) {
        if (m->motion != MOTION_TORQUE) {
            enter(axis, MOTION_TORQUE, axis->feedback.speed);
        }
        m->i_q_target = command->i_q;
    }
}

/* ---- controllers ------------------------------------------------------------------------------------------------ */

static frac32_t limited_speed(axis_t *axis, frac32_t speed)
{
    const frac32_t limited = f32_clip(speed, axis->limits.speed);
    if (limited != speed) {
        report(axis, LIMIT_SPEED);
    }
    return limited;
}

/* Where the shaft might leave its soft limits: everywhere but on the way to a target, which lies inside. */
static frac32_t confined_speed(axis_t *axis, frac32_t speed)
{
    const speed_range_t range = soft_limits_speed(axis);
    const bool over = speed > range.most && range.most < axis->limits.speed;
    const bool under = speed < range.least && range.least > -axis->limits.speed;
    if (over || under) {
        report(axis, LIMIT_POSITION);
        return over ? range.most : range.least;
    }
    return speed;
}

static void confine_target(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    if ((axis->features & FEATURE_POSITION_LIMITS) == 0U) {
        m->target_clipped = false;
        return;
    }
    const int32_t target = soft_limits_target(axis, m->target, path_position(&m->path));
    m->target_clipped = m->target_clipped || target != m->target;
    m->target = target;
    if (m->target_clipped) {
        report(axis, LIMIT_POSITION);
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
        m->path_forward = (axis->features & FEATURE_SPEED_FORWARD) != 0U; /* switched in motion it would be a blow */
    }
    path_step(&m->path, m->target, path_step_of(axis->config, axis->limits.speed), axis->path_omega_n_ts);
    shape(m, path_speed_of(axis->config, m->path.output - before));
}

/* A current that pushes off the target creeps on, count by count, wherever the friction only just holds it. */
static bool rests(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const int32_t off = i32_sub_wrap(m->target, axis->feedback.position);
    const int32_t most = m->resting ? REST_LEFT : REST_COUNTS;
    const frac32_t held = pi_integral(&m->speed_pi);
    const bool pushes_off = (off > 0 && held < 0) || (off < 0 && held > 0);
    m->resting = path_at_rest(&m->path, m->target) && off <= most && off >= -most;
    return m->resting && !pushes_off;
}

/* F26: proportional only, because no overshoot is allowed (E42..E45). */
static frac32_t wanted_speed(const axis_t *axis, path_position_t behind)
{
    const frac32_t behind_q8 = sat32(asr64(behind, PATH_BITS - 8));
    const frac32_t forward = axis->motion.path_forward ? axis->motion.shaped_speed : 0;
    return sat32(forward + asr64((int64_t)behind_q8 * axis->config->position_gain, 8));
}

/* Speed within the limit, or within the path's own speed while that still comes down to a lower limit. */
static frac32_t followed_speed(axis_t *axis, path_position_t behind)
{
    const frac32_t speed = wanted_speed(axis, behind);
    const frac32_t limited = limited_speed(axis, speed);
    if (limited == speed) {
        return speed;
    }
    const frac32_t shaped = f32_abs(axis->motion.shaped_speed);
    return (shaped > axis->limits.speed) ? f32_clip(speed, shaped) : limited;
}

/* Where a shaft would be that does what the position controller asks: what the real one lacks is its following error.
 * The lag that belongs to a plain gain is none, and what the bus holds back is no error of the shaft. */
static void follow_model(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    if ((axis->features & FEATURE_FOLLOWING_ERROR) == 0U || m->held_back) {
        m->model = path_counts(axis->feedback.position);
        return;
    }
    const path_position_t behind = path_beyond(m->path.output, path_whole(m->model)) - path_part(m->model);
    m->model += path_step_of(axis->config, followed_speed(axis, behind));
}

static frac32_t position_controller(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    confine_target(axis);
    follow_path(axis);
    follow_model(axis);
    if (rests(axis)) {
        return 0;
    }
    return followed_speed(axis, path_beyond(m->path.output, axis->feedback.position));
}

static frac32_t ramp(frac32_t from, frac32_t to, frac32_t step)
{
    return f32_add(from, f32_limit((int64_t)to - from, step));
}

/* Slow enough to hold, or to coast. */
static bool slow(const axis_t *axis) { return f32_abs(axis->feedback.speed) <= axis->config->stop_speed; }

/* The shaft of a stop has come to rest, or has turned round between two looks at it. */
static bool at_rest(const axis_t *axis)
{
    return slow(axis) || (axis->feedback.speed < 0) != (axis->motion.stopping < 0);
}

/* A stop ends within a stated time, even where the host wants gentle starts. */
static frac32_t stop_acceleration(const axis_t *axis)
{
    const frac32_t least = axis->config->stop_acceleration;
    return (axis->limits.acceleration > least) ? axis->limits.acceleration : least;
}

/* Towards the set-point; and down to a limit that has been lowered, within a stated time as in a stop. */
static frac32_t ramped_speed(axis_t *axis)
{
    const motion_state_t *m = &axis->motion;
    const bool lowered = limited_speed(axis, m->speed_ramp) != m->speed_ramp;
    const frac32_t target = limited_speed(axis, m->speed_target);
    return ramp(m->speed_ramp, target, lowered ? stop_acceleration(axis) : axis->limits.acceleration);
}

/* What is known to be needed, before there is an error: current against friction and for the acceleration. */
static frac32_t forward_current(const axis_t *axis)
{
    const motion_state_t *m = &axis->motion;
    frac32_t i_q = 0;
    if ((axis->features & FEATURE_FRICTION) != 0U) {
        i_q = friction_current(&axis->config->friction, m->shaped_speed);
    }
    /* On a path that the shaft trails, the acceleration of the shaft is another one. */
    const bool in_time = m->motion != MOTION_POSITION || m->path_forward;
    if ((axis->features & FEATURE_ACCELERATION_FORWARD) != 0U && in_time) {
        const int64_t inertia = asr64((int64_t)m->acceleration * axis->config->acceleration_forward, 16);
        i_q = sat32(i_q + inertia);
    }
    return i_q;
}

/* True if a current takes energy out of a shaft that turns fast enough to return it to the bus. */
static bool returns_energy(const axis_t *axis, bool negative)
{
    const frac32_t speed = axis->feedback.speed;
    return f32_abs(speed) > axis->config->regeneration_speed && (speed < 0) != negative;
}

/* Current limit in a direction: less against the motion while the bus cannot take what braking returns. */
static frac16_t current_limit(const axis_t *axis, bool negative)
{
    const frac16_t limit = axis->limits.i_q;
    return returns_energy(axis, negative) ? f16_mul(limit, axis->bearable) : limit;
}

static void hold_back(axis_t *axis, bool held)
{
    axis->motion.held_back = held;
    axis->current_ref.d = 0; /* E23 */
    if (held) {
        report(axis, LIMIT_REGENERATION);
        axis->current_ref.d = f16_neg(f16_mul(axis->config->copper_current, f16_sub(FRAC16_MAX, axis->bearable)));
    }
}

static const pi_gains_t *speed_gains(const axis_t *axis)
{
    return axis->sensorless ? &axis->config->observed_speed : &axis->config->speed;
}

static frac16_t speed_controller(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const frac32_t error = f32_sub(m->speed_ref, axis->feedback.speed);
    const pi_gains_t *gains = speed_gains(axis);
    if ((axis->features & FEATURE_ANTI_WINDUP) == 0U) {
        m->speed_pi.excess = 0; /* as with Kc = 0 */
    }
    /* The integral part sums the way that the encoder has counted. M/T's speed falls for tens of milliseconds after the
     * shaft has stopped: its sum would push the shaft off again. */
    pi_integrate(&m->speed_pi, gains, f32_sub(m->speed_ref, axis->feedback.mean_speed));
    const pi_sum_t sum = pi_sum_add(m->speed_pi.integral, error, gains->kp) + pi_sum_of(forward_current(axis));
    const frac16_t limit = current_limit(axis, sum < 0);
    const frac32_t i_q = pi_limit(&m->speed_pi, sum, f32_from_f16(limit));
    m->saturated = m->speed_pi.excess != 0;
    hold_back(axis, m->saturated && limit < axis->limits.i_q);
    if (m->saturated) {
        report(axis, LIMIT_CURRENT);
    }
    return f16_from_f32(i_q);
}

/* Current against a load that drives the shaft past a limit of the speed: it grows while the shaft is past it, and is
 * given back within it. At the upper limit it is negative. */
static frac32_t resist(axis_t *axis, speed_range_t range)
{
    const gain_t ki = speed_gains(axis)->ki;
    const frac32_t limit = f32_from_f16(axis->limits.i_q);
    const frac32_t speed = axis->feedback.mean_speed;
    const frac32_t before = axis->motion.resistance;
    if (before == 0 && speed <= range.most && speed >= range.least) {
        return 0; /* almost always */
    }
    const frac32_t over = f32_add((before < 0) ? before : 0, f32_gain(f32_sub(range.most, speed), ki));
    const frac32_t under = f32_add((before > 0) ? before : 0, f32_gain(f32_sub(range.least, speed), ki));
    axis->motion.resistance = ((over < 0) ? f32_clip(over, limit) : 0) + ((under > 0) ? f32_clip(under, limit) : 0);
    return axis->motion.resistance;
}

/* Torque within the speed limits: near them the speed controller's proportional part takes the current back, and its
 * integral part holds against a load. */
static frac16_t torque_controller(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const gain_t kp = speed_gains(axis)->kp;
    const speed_range_t range = soft_limits_speed(axis);
    const frac32_t held = resist(axis, range);
    const frac32_t room_above = f32_gain(f32_sub(range.most, axis->feedback.speed), kp);
    const frac32_t room_below = f32_gain(f32_sub(range.least, axis->feedback.speed), kp);
    const frac32_t most = f32_add(room_above, (held < 0) ? held : 0);
    const frac32_t least = f32_add(room_below, (held > 0) ? held : 0);
    const frac16_t wanted = f16_limit(m->i_q_target, axis->limits.i_q);
    if (wanted != m->i_q_target) {
        report(axis, LIMIT_CURRENT);
    }
    frac32_t i_q = f32_from_f16(wanted);
    if (i_q > most || i_q < least) {
        const bool soft = (i_q > most) ? range.most < axis->limits.speed : range.least > -axis->limits.speed;
        report(axis, soft ? LIMIT_POSITION : LIMIT_SPEED);
        i_q = (i_q > most) ? most : least;
    }
    const frac16_t limit = current_limit(axis, i_q < 0);
    const frac16_t result = f16_limit(f16_from_f32(i_q), limit);
    hold_back(axis, f32_abs(i_q) > f32_from_f16(limit) && limit < axis->limits.i_q);
    m->speed_ref = axis->feedback.speed;
    m->saturated = false;
    pi_reset(&m->speed_pi, f32_from_f16(result)); /* the speed controller takes over from here without a jump */
    return result;
}

void motion_start(axis_t *axis)
{
    pi_reset(&axis->motion.speed_pi, 0);
    axis->motion.speed_target = 0;
    axis->motion.i_q_target = 0;
    axis->motion.speed_ref = 0;
    axis->motion.saturated = false;
    axis->motion.held_back = false;
    supervision_start(&axis->supervision);
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
    m->speed_ramp = axis->feedback.speed;
    supervision_start(&axis->supervision);
    enter(axis, MOTION_SPEED, axis->feedback.speed);
}

void motion_listen(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const axis_command_t *command = &axis->command;
    if (!axis->requested || command->quick_stop || command->mode != CONTROL_MODE_SPEED) {
        m->speed_target = 0;
    } else if (command->fresh_speed) {
        m->speed_target = command->speed;
    }
    const bool unable = command->mode != CONTROL_MODE_SPEED || m->speed_target != 0;
    if (axis->requested && unable && motion_wanted_speed(axis) == 0) {
        report(axis, LIMIT_SENSORLESS);
    }
}

frac32_t motion_wanted_speed(const axis_t *axis)
{
    const speed_range_t range = soft_limits_speed(axis);
    const frac32_t least = axis->config->startup.minimum_speed;
    frac32_t speed = axis->motion.speed_target;
    if (speed > range.most) {
        speed = range.most;
    }
    if (speed < range.least) {
        speed = range.least;
    }
    return (speed < least && speed > -least) ? 0 : speed;
}

bool motion_too_slow(const axis_t *axis)
{
    const frac32_t told = (axis->motion.motion == MOTION_TORQUE) ? axis->feedback.speed : axis->motion.speed_ramp;
    return f32_abs(told) < axis->config->startup.minimum_speed;
}

void motion_step(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    take_commands(axis);
    switch (m->motion) {
    case MOTION_TORQUE:
        axis->current_ref.q = torque_controller(axis);
        return;
    case MOTION_SPEED:
        m->speed_ramp = confined_speed(axis, ramped_speed(axis));
        shape(m, m->speed_ramp);
        m->speed_ref = m->speed_ramp;
        break;
    case MOTION_STOP:
        m->speed_ramp = confined_speed(axis, ramp(m->speed_ramp, 0, stop_acceleration(axis)));
        shape(m, m->speed_ramp);
        m->speed_ref = m->speed_ramp;
        if (m->speed_ramp == 0) {
            if (m->stop_ticks < UINT16_MAX &&
                !m->held_back) { /* what the bus holds back takes the time that it takes */
                m->stop_ticks++;
            }
            /* With little current the shaft is behind the ramp: a point latched now would have to be run back to. */
            if (stop_holds(axis) && at_rest(axis) && !axis->sensorless) {
                hold(axis);
            }
        }
        break;
    default:
        m->speed_ref = position_controller(axis);
        break;
    }
    axis->current_ref.q = speed_controller(axis);
}

bool motion_stopped(const axis_t *axis)
{
    const motion_state_t *m = &axis->motion;
    return m->motion == MOTION_STOP && m->speed_ramp == 0 &&
           (slow(axis) || m->stop_ticks >= axis->config->stop_ticks_most);
}

int32_t motion_position_ref(const axis_t *axis)
{
    return (axis->motion.motion == MOTION_POSITION) ? path_position(&axis->motion.path) : axis->feedback.position;
}

int32_t motion_following_error(const axis_t *axis)
{
    if (axis->motion.motion != MOTION_POSITION) {
        return 0;
    }
    return i32_sub_wrap(path_whole(axis->motion.model), axis->feedback.position);
}
