#include "drive/motion.h"

/* A shaft that rests this close to its target is left alone. Closer than the encoder can tell, the integral part of the
 * speed controller would hunt against the friction for ever. */
#define REST_COUNTS 1

/* ---- conversions ------------------------------------------------------------------------------------------------ */

/* Speed as path steps: counts with 24 fraction bits per slow tick. path_step_per_speed has 16, the speed 31. */
static path_position_t step_of(const axis_t *axis, frac32_t speed)
{
    return asr64((int64_t)speed * axis->config->path_step_per_speed, 31 - (PATH_BITS - 16));
}

/* How far the shaft trails its position set-point at this speed: the position controller is a plain gain. */
static int32_t lag_of(const axis_t *axis, frac32_t speed) { return speed / axis->config->position_gain; }

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

static void enter_position(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    if (m->motion == MOTION_POSITION) {
        return;
    }
    const frac32_t speed = axis->feedback.speed;
    path_reset(&m->path, i32_add_wrap(axis->feedback.position, lag_of(axis, speed)), step_of(axis, speed),
               axis->path_omega_n_ts);
    m->motion = MOTION_POSITION;
}

static void enter_speed(axis_t *axis)
{
    if (axis->motion.motion != MOTION_SPEED) {
        axis->motion.speed_ramp = axis->feedback.speed;
        axis->motion.motion = MOTION_SPEED;
    }
}

static void enter_stop(axis_t *axis)
{
    if (axis->motion.motion != MOTION_STOP) {
        axis->motion.speed_ramp = axis->feedback.speed;
        axis->motion.stop_ticks = 0;
        axis->motion.motion = MOTION_STOP;
    }
}

static void hold(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    path_reset(&m->path, axis->feedback.position, 0, axis->path_omega_n_ts);
    m->target = axis->feedback.position;
    m->motion = MOTION_POSITION;
}

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
        m->motion = MOTION_TORQUE;
    } else {
        enter_stop(axis);
    }
}

static void take_commands(axis_t *axis)
{
    const axis_command_t *command = &axis->command;
    motion_state_t *m = &axis->motion;
    if (!axis->requested || command->quick_stop) {
        const bool holds = axis->requested && m->motion == MOTION_POSITION && !command->fresh_quick_stop;
        if (!holds) {
            enter_stop(axis);
        }
        return;
    }
    if (command->fresh_mode) {
        take_mode(axis);
    }
    if (command->fresh_position && command->mode == CONTROL_MODE_POSITION) {
        enter_position(axis);
        m->target = command->position;
    }
    if (command->fresh_speed && command->mode == CONTROL_MODE_SPEED) {
        enter_speed(axis);
        m->speed_target = command->speed;
    }
    if (command->fresh_i_q && command->mode == CONTROL_MODE_TORQUE) {
        m->motion = MOTION_TORQUE;
        m->i_q_target = command->i_q;
    }
}

/* ---- controllers ------------------------------------------------------------------------------------------------ */

static frac32_t limited_speed(axis_t *axis, int64_t speed)
{
    const frac32_t limited = f32_limit(speed, axis->limits.speed);
    if (limited != speed) {
        axis->active_limits = (uint16_t)(axis->active_limits | LIMIT_SPEED);
    }
    return limited;
}

/* F26: proportional only, because no overshoot is allowed (E42..E45). */
static frac32_t position_controller(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    path_step(&m->path, m->target, step_of(axis, axis->limits.speed), axis->path_omega_n_ts);
    if (path_at_rest(&m->path, m->target)) {
        const int32_t off = i32_sub_wrap(m->target, axis->feedback.position);
        if (off <= REST_COUNTS && off >= -REST_COUNTS) {
            return 0;
        }
    }
    const int64_t error = m->path.output - ((int64_t)axis->feedback.position * (INT64_C(1) << PATH_BITS));
    const frac32_t error_q8 = sat32(asr64(error, PATH_BITS - 8));
    return limited_speed(axis, asr64((int64_t)error_q8 * axis->config->position_gain, 8));
}

static frac32_t ramp(frac32_t from, frac32_t to, frac32_t step)
{
    return f32_add(from, f32_limit((int64_t)to - from, step));
}

/* Slow enough to hold, or to coast. */
static bool slow(const axis_t *axis) { return f32_abs(axis->feedback.speed) <= axis->config->stop_speed; }

/* A stop ends within a stated time, even where the host wants gentle starts. */
static frac32_t stop_acceleration(const axis_t *axis)
{
    const frac32_t least = axis->config->stop_acceleration;
    return (axis->limits.acceleration > least) ? axis->limits.acceleration : least;
}

static frac16_t speed_controller(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const frac32_t error = f32_sub(m->speed_ref, axis->feedback.speed);
    pi_gains_t gains = axis->config->speed;
    if ((axis->features & FEATURE_ANTI_WINDUP) == 0U) {
        gains.kc = 0;
    }
    const frac32_t i_q = pi_step(&m->speed_pi, &gains, error, 0, f32_from_f16(axis->limits.i_q));
    if (m->speed_pi.excess != 0) {
        axis->active_limits = (uint16_t)(axis->active_limits | LIMIT_CURRENT);
    }
    return f16_from_f32(i_q);
}

/* Torque within the speed limit: near it the proportional part of the speed controller takes the current back. */
static frac16_t torque_controller(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const gain_t kp = axis->config->speed.kp;
    const frac32_t most = f32_gain(f32_sub(axis->limits.speed, axis->feedback.speed), kp);
    const frac32_t least = f32_gain(f32_sub(-axis->limits.speed, axis->feedback.speed), kp);
    const frac16_t wanted = f16_limit(m->i_q_target, axis->limits.i_q);
    if (wanted != m->i_q_target) {
        axis->active_limits = (uint16_t)(axis->active_limits | LIMIT_CURRENT);
    }
    int64_t i_q = f32_from_f16(wanted);
    if (i_q > most || i_q < least) {
        i_q = (i_q > most) ? most : least;
        axis->active_limits = (uint16_t)(axis->active_limits | LIMIT_SPEED);
    }
    const frac16_t result = f16_limit(f16_from_f32(sat32(i_q)), axis->limits.i_q);
    m->speed_ref = axis->feedback.speed;
    pi_reset(&m->speed_pi, f32_from_f16(result)); /* the speed controller takes over from here without a jump */
    return result;
}

void motion_start(axis_t *axis)
{
    pi_reset(&axis->motion.speed_pi, 0);
    axis->motion.speed_target = 0;
    axis->motion.i_q_target = 0;
    axis->motion.speed_ref = 0;
    axis->motion.stall_ticks = 0;
    axis->motion.runaway_ticks = 0;
    hold(axis);
}

/* ---- supervision ------------------------------------------------------------------------------------------------ */

static uint16_t count_while(bool holds, uint16_t ticks) { return holds ? (uint16_t)(ticks + 1U) : 0U; }

static void supervise(axis_t *axis, bool saturated)
{
    motion_state_t *m = &axis->motion;
    const frac32_t speed = f32_abs(axis->feedback.speed);
    const frac32_t margin = axis->config->runaway_margin;

    /* Braked by the full current, or beyond its limit, the shaft has to lose speed, or at least not to gain any. */
    const bool opposed = saturated && ((axis->feedback.speed < 0) != (axis->current_ref.q < 0));
    const bool beyond = speed > f32_add(axis->limits.speed, margin);
    if (!(opposed || beyond) || speed < m->braked_speed) {
        m->braked_speed = speed;
    }
    m->runaway_ticks = count_while(speed > f32_add(m->braked_speed, margin), m->runaway_ticks);
    m->stall_ticks = count_while(saturated && axis->feedback.still, m->stall_ticks);
}

void motion_step(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    take_commands(axis);
    axis->current_ref.d = 0; /* E23 */
    switch (m->motion) {
    case MOTION_TORQUE:
        axis->current_ref.q = torque_controller(axis);
        supervise(axis, false);
        return;
    case MOTION_SPEED:
        m->speed_ramp = ramp(m->speed_ramp, limited_speed(axis, m->speed_target), axis->limits.acceleration);
        m->speed_ref = m->speed_ramp;
        break;
    case MOTION_STOP:
        m->speed_ramp = ramp(m->speed_ramp, 0, stop_acceleration(axis));
        m->speed_ref = m->speed_ramp;
        if (m->speed_ramp == 0) {
            m->stop_ticks = (m->stop_ticks < UINT16_MAX) ? (uint16_t)(m->stop_ticks + 1U) : UINT16_MAX;
            /* With little current the shaft is behind the ramp: a point latched now would have to be run back to. */
            if (axis->requested && slow(axis)) {
                hold(axis);
            }
        }
        break;
    default:
        m->speed_ref = position_controller(axis);
        break;
    }
    axis->current_ref.q = speed_controller(axis);
    supervise(axis, m->speed_pi.excess != 0);
}

bool motion_runs_away(const axis_t *axis) { return axis->motion.runaway_ticks > axis->config->runaway_ticks_most; }

bool motion_stalled(const axis_t *axis) { return axis->motion.stall_ticks > axis->config->stall_ticks_most; }

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
