#include "drive/speed_control.h"

#include "drive/soft_limits.h"

#define DITHER_COUNTS 4 /* counts of the encoder per slow tick */

/* Feed-forward current, for friction and for the acceleration: J alpha / Kt. */
static frac32_t forward_current(const axis_t *axis, const axis_config_t *config)
{
    const motion_state_t *m = &axis->motion;
    frac32_t i_q = 0;
    if ((axis->parameter.features & FEATURE_FRICTION) != 0U) {
        i_q = friction_current(&config->friction, m->shaped_speed);
    }
    /* If the shaft lags the path, its acceleration differs from that of the path. */
    const bool in_time = m->motion != MOTION_POSITION || m->path_forward;
    const bool timed = m->motion == MOTION_TRAJECTORY;
    if (timed || ((axis->parameter.features & FEATURE_ACCELERATION_FORWARD) != 0U && in_time)) {
        const int64_t inertia = asr64((int64_t)m->acceleration * config->acceleration_forward, 16);
        i_q = sat32(i_q + inertia);
    }
    if (timed) {
        i_q = f32_add(i_q, f32_from_f16(axis->trajectory.reference.i_q));
    }
    return i_q;
}

/* True if a current of this sign decelerates a shaft that is fast enough to return energy to the bus. */
static bool returns_energy(const axis_t *axis, bool negative)
{
    const frac32_t speed = axis->feedback.speed;
    return f32_abs(speed) > axis->config->regeneration_speed && (speed < 0) != negative;
}

/* True if bus or field weakening reduce the current limit of one direction below that of the host. */
static bool restricted(const axis_t *axis)
{
    return axis->regen_derating != FRAC16_MAX || field_weakening_active(&axis->weakening);
}

/* Current limit for one direction: reduced against the motion while the bus cannot accept the regenerated power, and
 * reduced by the field-weakening current. */
static frac16_t restricted_limit(const axis_t *axis, bool negative)
{
    const field_weakening_t *weakening = &axis->weakening;
    const bool returns = returns_energy(axis, negative);
    frac16_t limit = axis->current_max.q;
    if (field_weakening_active(weakening)) {
        limit = f16_limit(limit, returns ? weakening->i_q_max : field_weakening_motoring(weakening));
    }
    return returns ? f16_mul(limit, axis->regen_derating) : limit;
}

/* `reduced`: the limit is below the requested current, whose sign is given by `negative`. */
static void reduce_current(axis_t *axis, bool reduced, bool negative)
{
    axis->motion.current_reduced = reduced;
    axis->current_ref.d = field_weakening_i_d(&axis->weakening);
    if (reduced && axis->regen_derating != FRAC16_MAX && returns_energy(axis, negative)) {
        axis_report(axis, LIMIT_REGENERATION);
        const frac16_t copper = f16_mul(axis->config->copper_current, f16_sub(FRAC16_MAX, axis->regen_derating));
        if (copper > -axis->current_ref.d) {
            axis->current_ref.d = f16_neg(copper);
        }
    }
}

/* Set i_d*. `less` is the result of restricted(); `reduced` means that i_q has been limited by it. */
static void set_i_d(axis_t *axis, bool less, bool reduced, bool negative)
{
    axis->motion.current_reduced = false;
    axis->current_ref.d = 0; /* E23; the usual case */
    if (less) {
        reduce_current(axis, reduced, negative);
    }
}

/* Report the reason for a current at its limit; true if the limit is below that of the host because the winding is
 * hot. */
static bool report_current(axis_t *axis)
{
    const bool derated = axis->current_max.q < axis->limits.i_q;
    axis_report(axis, derated ? LIMIT_CURRENT | LIMIT_TEMPERATURE : LIMIT_CURRENT);
    return derated;
}

const pi_gains_t *speed_control_full_gains(const axis_t *axis, const axis_config_t *config)
{
    return axis->sensorless ? &config->observed_speed : &config->speed;
}

/* Smallest swing of an oscillation: a quarter of the current limit of the configuration, and more than the dither of a
 * shaft at rest, whose speed error is a few counts of the encoder per slow tick. A lower limit in force does not make
 * the dither smaller. A swing that the current cannot have is not found. */
static uint16_t oscillation_swing_min(const axis_t *axis, const axis_config_t *config, gain_t kp)
{
    const uint16_t fine = POSITION_PER_TURN / 4;
    const uint16_t fitted = encoder_lines(&config->encoder);
    const uint16_t lines = (axis->sensorless || fitted > fine) ? fine : fitted;
    const uint16_t coarse = (uint16_t)((fine + lines - 1U) / lines); /* position counts per count, rounded up */
    const frac32_t error = sat32((int64_t)config->speed_per_path_step * DITHER_COUNTS * coarse);
    const int64_t dither = asr64((int64_t)error * kp, GAIN_BITS + 16U);
    const int64_t part = config->i_q_limit / 4;
    const int64_t swing = (dither > part) ? dither : part;
    return (swing > UINT16_MAX) ? UINT16_MAX : (uint16_t)swing;
}

/* Set the gains. With the bandwidth divided by 2^shift, the corner of the integral part falls as much: the phase margin
 * remains. */
static void set_gains(axis_t *axis, const axis_config_t *config, uint16_t shift)
{
    motion_state_t *m = &axis->motion;
    const pi_gains_t *gains = speed_control_full_gains(axis, config);
    m->gain_shift = shift;
    m->speed_gains = gains;
    m->position_gain_target = config->position_gain;
    axis->diagnosis.oscillation.swing_min = oscillation_swing_min(axis, config, gains->kp);
    if (shift != 0U) {
        m->reduced_gains = (pi_gains_t){asr32(gains->kp, shift), asr32(gains->ki, 2U * shift), gains->kc};
        m->speed_gains = &m->reduced_gains;
        const int32_t position_gain = asr32(config->position_gain, shift);
        m->position_gain_target = (position_gain != 0) ? position_gain : 1;
    }
}

void speed_control_start(axis_t *axis)
{
    axis->diagnosis.oscillation = (oscillation_monitor_t){0};
    axis->motion.forced = false;
    set_gains(axis, axis->config, 0);
}

void speed_control_retune(axis_t *axis, const axis_config_t *config, uint16_t gain_shift)
{
    motion_state_t *m = &axis->motion;
    const pi_gains_t before = *m->speed_gains;
    const frac32_t error = f32_sub(m->speed_ref, axis->feedback.speed);
    const frac32_t gained = f32_sub(forward_current(axis, axis->config), forward_current(axis, config));
    set_gains(axis, config, gain_shift);
    const pi_sum_t kept = pi_retuned(&m->speed_pi, &before, m->speed_gains, error);
    m->speed_pi.integral = pi_sum_saturated(kept + pi_sum_of(gained));
}

/* What the feed-forward against torque ripple changes in i_q*, the output of the controller within `limit`. */
static frac32_t applied_ripple(const axis_t *axis, frac32_t i_q, frac32_t limit)
{
    const int64_t without = (int64_t)i_q - axis->motion.speed_pi.excess - axis->ripple.current;
    return i_q - f32_limit(without, limit);
}

/* Speed controller (F20, E34..E37), PI with anti-windup (control/pi.h):
 *   i_q* = limit(Kp (omega* - omega) + i_i + i_forward, -i_max, i_max)
 * i_i integrates omega* minus the mean speed of the tick; each direction may have a limit of its own. */
frac16_t speed_control(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const frac32_t error = f32_sub(m->speed_ref, axis->feedback.speed);
    const pi_gains_t *gains = m->speed_gains;
    if ((axis->parameter.features & FEATURE_ANTI_WINDUP) == 0U) {
        m->speed_pi.excess = 0; /* equivalent to Kc = 0 */
    }
    /* The integral part uses the mean speed, i.e. the counted distance. The M/T speed decays for tens of milliseconds
     * after the shaft has stopped; its integral would push the shaft off again. */
    pi_integrate(&m->speed_pi, gains, f32_sub(m->speed_ref, axis->feedback.mean_speed));
    const frac32_t forward = f32_add(forward_current(axis, axis->config), axis->ripple.current);
    const pi_sum_t sum = pi_sum_add(m->speed_pi.integral, error, gains->kp) + pi_sum_of(forward);
    const bool less = restricted(axis);
    const frac16_t limit = less ? restricted_limit(axis, sum < 0) : axis->current_max.q;
    const frac32_t i_q = pi_limit(&m->speed_pi, sum, f32_from_f16(limit));
    m->saturated = m->speed_pi.excess != 0;
    if (axis->ripple.current != 0) {
        axis->ripple.applied = applied_ripple(axis, i_q, f32_from_f16(limit));
    }
    set_i_d(axis, less, m->saturated && limit < axis->current_max.q, sum < 0);
    if (m->saturated) {
        m->current_reduced = report_current(axis) || m->current_reduced;
    }
    return f16_from_f32(i_q);
}

/* Largest current towards a limit of the speed, given the margin of the speed and of the mean speed. Near the limit the
 * proportional part of the speed controller reduces the current. Beyond it the integral part `held` (<= 0) grows
 * against a load that drives the shaft, and decays again within the limit. */
static frac32_t current_margin(const axis_t *axis, frac32_t ahead, frac32_t mean_ahead, frac32_t *held)
{
    const pi_gains_t *gains = axis->motion.speed_gains;
    const frac32_t integral = f32_add(*held, f32_gain(mean_ahead, gains->ki));
    *held = (integral < 0) ? f32_clip(integral, f32_from_f16(axis->limits.i_q)) : 0;
    return f32_add(*held, f32_gain(ahead, gains->kp));
}

frac16_t torque_control(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const feedback_t *feedback = &axis->feedback;
    const speed_range_t range = soft_limits_speed(axis);
    frac32_t above = (m->limit_hold_current < 0) ? m->limit_hold_current : 0;
    frac32_t below = (m->limit_hold_current > 0) ? -m->limit_hold_current : 0;
    const frac32_t max =
        current_margin(axis, f32_sub(range.max, feedback->speed), f32_sub(range.max, feedback->mean_speed), &above);
    const frac32_t back =
        current_margin(axis, f32_sub(feedback->speed, range.min), f32_sub(feedback->mean_speed, range.min), &below);
    const frac32_t min = f32_sub(0, back);
    m->limit_hold_current = above - below;
    const frac16_t requested = f16_limit(m->i_q_target, axis->current_max.q);
    if (requested != m->i_q_target) {
        (void)report_current(axis);
    }
    frac32_t i_q = f32_from_f16(requested);
    if (i_q > max || i_q < min) {
        const bool soft = (i_q > max) ? range.max < axis->limits.speed : range.min > -axis->limits.speed;
        axis_report(axis, soft ? axis->home.limit : LIMIT_SPEED);
        i_q = (i_q > max) ? max : min;
    }
    const bool less = restricted(axis);
    const frac16_t limit = less ? restricted_limit(axis, i_q < 0) : axis->current_max.q;
    const frac16_t result = f16_limit(f16_from_f32(i_q), limit);
    set_i_d(axis, less, f32_abs(i_q) > f32_from_f16(limit) && limit < axis->current_max.q, i_q < 0);
    m->speed_ref = axis->feedback.speed;
    m->saturated = false;
    pi_reset(&m->speed_pi, f32_from_f16(result)); /* bumpless transfer to the speed controller */
    return result;
}

frac16_t press_control(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const frac16_t i_q = f16_limit(m->i_q_target, axis->current_max.q);
    m->speed_ref = 0;
    m->saturated = false;
    pi_reset(&m->speed_pi, f32_from_f16(i_q));
    axis->current_ref.d = 0;
    axis_report(axis, LIMIT_CURRENT);
    return i_q;
}
