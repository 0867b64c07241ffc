#include "drive/sensorless_startup.h"

#include "drive/current_drive.h"
#include "drive/motion.h"
#include "drive/sensorless_estimate.h"

#define QUARTER_TURN INT16_C(16384)
#define SETTLE_TICKS 6 /* slow ticks until the observer has the back-EMF of a turning shaft */
#define LOCK_TICKS 24  /* lock time of the PLL at the minimum speed, in slow ticks */
#define PROVE_TICKS 72 /* slow ticks: rise of the current plus 64 speed samples */
#define RATIO_BITS 14

static frac32_t with_sign(frac32_t speed, bool backwards) { return backwards ? -speed : speed; }

static void enter(startup_t *startup, startup_phase_t phase)
{
    startup->phase = phase;
    startup->ticks = 0;
    startup->passed = 0;
}

void startup_begin(axis_t *axis, bool backwards)
{
    startup_t *startup = &axis->startup;
    *startup = (startup_t){0};
    startup->backwards = backwards;
    enter(startup, STARTUP_CATCH);
    sensorless_estimate_start(axis, 0, 0);
}

/* ---- the fast loop ------------------------------------------------------------------------------------------------ */

/* Stator frame, no current: the windings need the back-EMF as voltage, and the observer gives it sooner than an integral
 * part would. */
static void hold_current_off(axis_t *axis)
{
    const ab_t emf = back_emf_observer_emf(&axis->estimate.observer, &axis->config->observer);
    axis->current_loop.d.integral = pi_sum_of(f32_from_f16(emf.alpha));
    axis->current_loop.q.integral = pi_sum_of(f32_from_f16(emf.beta));
    drive_observed(axis, 0);
}

void startup_fast(axis_t *axis)
{
    startup_t *startup = &axis->startup;
    if (startup->phase == STARTUP_RAMP) {
        drive_observed(axis, pll_upper(startup->angle));
        startup->angle += (uint32_t)startup->step;
    } else if (startup->phase == STARTUP_PROVE) {
        drive_observed(axis, axis->feedback.theta_e);
    } else {
        hold_current_off(axis);
    }
}

/* ---- catching a turning shaft --------------------------------------------------------------------------------------- */

static frac16_t least_emf(const axis_t *axis)
{
    return sensorless_estimate_emf_at(axis, axis->config->startup.minimum_speed);
}

static void begin_ramp(axis_t *axis)
{
    startup_t *startup = &axis->startup;
    enter(startup, STARTUP_RAMP);
    axis->estimate.locked = false;
    startup->angle = 0;
    startup->step = 0;
    startup->speed = 0;
    startup->current = f32_from_f16(axis->config->startup.first_current);
    pi_reset(&axis->current_loop.d, 0);
    pi_reset(&axis->current_loop.q, 0);
}

/* Two back-EMF angles, one slow tick apart, give the speed, so the PLL starts in lock. */
static void begin_track(axis_t *axis)
{
    startup_t *startup = &axis->startup;
    const ab_t now = axis->estimate.emf;
    const frac16_t to = f16_angle(now.alpha, now.beta);
    const frac16_t from = f16_angle(startup->emf.alpha, startup->emf.beta);
    const frac16_t turn = f16_sub_wrap(to, from);
    const frac16_t rotor = f16_add_wrap(to, (turn < 0) ? QUARTER_TURN : -QUARTER_TURN);
    const int32_t step = (int32_t)turn * (INT32_C(65536) / AXIS_SLOW_PERIODS);
    enter(startup, STARTUP_TRACK);
    axis->estimate.locked = true;
    sensorless_estimate_clear_checks(axis);
    sensorless_estimate_set_angle(axis, ((uint32_t)(uint16_t)rotor << 16) + (uint32_t)asr32(step, 1), step);
}

static void seek(axis_t *axis)
{
    startup_t *startup = &axis->startup;
    if (startup->ticks > SETTLE_TICKS && axis->estimate.size >= least_emf(axis)) {
        begin_track(axis);
    } else if (startup->ticks >= axis->config->startup.catch_ticks) {
        begin_ramp(axis);
    }
    startup->emf = axis->estimate.emf;
}

/* True if the back-EMF is detected. At low speed its absence may be masked by dead time and resistance, and an
 * undisturbed PLL follows the vector. */
static bool seen(const axis_t *axis)
{
    const sensorless_estimate_t *estimate = &axis->estimate;
    const frac16_t expected = sensorless_estimate_emf_at(axis, estimate->speed);
    return estimate->locked && !emf_check_emf_missing(&estimate->check, &axis->config->emf_check, expected);
}

static dq_t rotate(dq_t x, uint32_t angle)
{
    const ab_t turned_x = park_inverse(x, sin_cos_of(pll_upper(angle)));
    return (dq_t){turned_x.alpha, turned_x.beta};
}

/* Transform current and voltage to the rotor frame without changing them. The rotor frame trails the previous frame by
 * `between`, and trailed it by `at_sample` when the current was sampled. Returns the current. */
static dq_t enter_rotor_frame(axis_t *axis, uint32_t between, uint32_t at_sample)
{
    const dq_t current = rotate(axis->current_loop.current, at_sample);
    const dq_t voltage = rotate(axis->current_loop.voltage, between);
    current_loop_set_speed(&axis->current_loop, &axis->config->current_loop, f16_from_f32(axis->estimate.speed));
    current_loop_take_over(&axis->current_loop, &axis->config->current_loop, current, voltage);
    axis->feedback.theta_e = pll_theta(&axis->estimate.pll);
    return current;
}

static void begin_prove(axis_t *axis)
{
    const pll_t *pll = &axis->estimate.pll;
    const uint32_t between = (uint32_t)0 - pll->angle;
    enter(&axis->startup, STARTUP_PROVE);
    axis->current_ref = enter_rotor_frame(axis, between, between + (uint32_t)pll->step);
}

static void track(axis_t *axis)
{
    axis->estimate.pll.backwards = axis->estimate.pll.integral < 0;
    if (axis->startup.ticks >= LOCK_TICKS) {
        begin_prove(axis);
    }
}

static void prove(axis_t *axis)
{
    startup_t *startup = &axis->startup;
    const frac32_t kept = f32_from_f16(axis->config->startup.first_current) / 2; /* same value as later without load */
    startup->i_d += f32_clip(kept - startup->i_d, axis->config->startup.fade_step);
    axis->current_ref = (dq_t){f16_from_f32(startup->i_d), 0};
    axis->estimate.pll.backwards = axis->estimate.pll.integral < 0;
    current_loop_set_speed(&axis->current_loop, &axis->config->current_loop, f16_from_f32(axis->estimate.speed));
}

static startup_result_t judge_prove(axis_t *axis)
{
    if (axis->startup.ticks < PROVE_TICKS) {
        return STARTUP_RUNS;
    }
    if (seen(axis) && axis->estimate.reliable) {
        return STARTUP_DONE;
    }
    begin_ramp(axis);
    return STARTUP_RUNS;
}

/* ---- the ramps ------------------------------------------------------------------------------------------------------ */

/* A swing about the vector appears as back-EMF across the vector, in excess of that of the vector's speed. */
static frac16_t damping_current(const axis_t *axis, frac32_t speed)
{
    const startup_t *startup = &axis->startup;
    const frac16_t angle = pll_upper(startup->angle - (uint32_t)asr32(startup->step, 1));
    const dq_t emf = park(axis->estimate.emf, sin_cos_of(angle));
    const int32_t swing = (int32_t)emf.q - sensorless_estimate_emf_at(axis, speed);
    const frac32_t current = f32_gain(f32_from_f16(sat16(-swing)), axis->config->startup.damping);
    return f16_limit(asr32(current, 16), axis->config->startup.damping_limit);
}

/* While the back-EMF is too small the PLL follows the vector, which the rotor trails by less than a quarter turn. */
static void lock(axis_t *axis, int32_t before)
{
    const startup_t *startup = &axis->startup;
    if (axis->estimate.locked) {
        axis->estimate.pll.integral += startup->step - before;
    } else if (axis->estimate.size >= least_emf(axis) && startup->speed >= axis->config->startup.minimum_speed) {
        axis->estimate.locked = true;
        pll_adapt(&axis->estimate.pll, &axis->config->pll, axis->estimate.size);
        sensorless_estimate_clear_checks(axis);
    } else {
        sensorless_estimate_set_angle(axis, startup->angle, startup->step);
    }
    axis->estimate.pll.backwards = startup->backwards;
}

static void ramp(axis_t *axis)
{
    startup_t *startup = &axis->startup;
    const startup_config_t *config = &axis->config->startup;
    const int32_t before = startup->step;
    startup->speed += f32_clip(config->final_speed - startup->speed, config->speed_step);
    const frac32_t missing = f32_from_f16(config->final_current) - startup->current;
    startup->current += f32_clip(missing, f32_abs(config->current_step));
    const frac32_t speed = with_sign(startup->speed, startup->backwards);
    startup->step = pll_step_of(&axis->config->pll, speed);
    lock(axis, before);
    current_loop_set_speed(&axis->current_loop, &axis->config->current_loop, f16_from_f32(speed));
    axis->current_ref = (dq_t){f16_from_f32(startup->current), damping_current(axis, speed)};
}

/* Criterion of the reference design; the upper bound has a tolerance, because at the end of the ramp the mean equals
 * the forced speed. */
static bool converged(const axis_t *axis)
{
    const startup_config_t *config = &axis->config->startup;
    const frac32_t forced = axis->startup.speed;
    const frac32_t mean = with_sign(speed_reliability_mean(&axis->estimate.reliability), axis->startup.backwards);
    const int64_t ratio = (int64_t)mean * (INT32_C(1) << RATIO_BITS);
    return seen(axis) && axis->estimate.reliable && ratio >= (int64_t)forced * config->mean_min &&
           ratio <= (int64_t)forced * config->mean_max;
}

static startup_result_t judge_ramp(axis_t *axis)
{
    startup_t *startup = &axis->startup;
    startup->passed = converged(axis) ? (uint16_t)(startup->passed + 1U) : 0U;
    if (startup->passed >= axis->config->startup.tests) {
        return STARTUP_DONE;
    }
    return (startup->ticks >= axis->config->startup.duration_ticks) ? STARTUP_FAILED : STARTUP_RUNS;
}

void startup_step(axis_t *axis)
{
    axis->startup.ticks++;
    switch (axis->startup.phase) {
    case STARTUP_CATCH:
        seek(axis);
        break;
    case STARTUP_TRACK:
        track(axis);
        break;
    case STARTUP_PROVE:
        prove(axis);
        break;
    default:
        ramp(axis);
        break;
    }
}

startup_result_t startup_judge(axis_t *axis)
{
    const startup_t *startup = &axis->startup;
    if (startup->ticks == 0U) {
        return STARTUP_RUNS; /* the phase has just begun */
    }
    switch (startup->phase) {
    case STARTUP_PROVE:
        return judge_prove(axis);
    case STARTUP_RAMP:
        return judge_ramp(axis);
    default:
        return STARTUP_RUNS;
    }
}

finding_t startup_failure(const axis_t *axis)
{
    const bool no_current = axis->current_loop.current.d < axis->config->startup.first_current / 4;
    return no_current ? FINDING_START_UP_NO_CURRENT : FINDING_START_UP_SLOW;
}

/* ---- hand-over ------------------------------------------------------------------------------------------------------ */

void startup_hand_over(axis_t *axis)
{
    startup_t *startup = &axis->startup;
    dq_t current = axis->current_loop.current;
    if (startup->phase == STARTUP_RAMP) {
        /* the voltage of the ramp leads the vector by the angle by which it will lead the rotor */
        const uint32_t between = startup->angle - axis->estimate.pll.angle;
        current = enter_rotor_frame(axis, between, between);
    }
    startup->i_d = f32_from_f16(current.d);
    axis->feedback.speed = axis->estimate.speed;
    axis->feedback.mean_speed = axis->estimate.speed;
    motion_start_turning(axis, current.q);
    axis->current_ref = current;
}

frac16_t startup_reduce_i_d(axis_t *axis)
{
    startup_t *startup = &axis->startup;
    const startup_config_t *config = &axis->config->startup;
    /* Without load part of the d current remains: with phase currents near zero the dead time would determine the
     * voltage. */
    const frac32_t first = axis->motion.current_reduced ? 0 : f32_from_f16(config->first_current);
    const frac32_t spare = first - f32_from_f16(f16_abs(axis->current_ref.q));
    const frac32_t kept = (spare > first / 2) ? first / 2 : ((spare > 0) ? spare : 0);
    startup->i_d += f32_clip(kept - startup->i_d, config->fade_step);
    return f16_from_f32(startup->i_d);
}
