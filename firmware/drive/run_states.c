/* run_states.c - the sub-states of RUN, each with a fast, a slow, an estimating and a checking function, and their
 * transitions (DRM 4.5, F37). */
#include "drive/run_states.h"

#include "diagnosis/fault_isolate.h"
#include "drive/angle_check.h"
#include "drive/axis_faults.h"
#include "drive/current_drive.h"
#include "drive/holding_brake.h"
#include "drive/homing.h"
#include "drive/limits.h"
#include "drive/motion.h"
#include "drive/outputs.h"
#include "drive/run_step.h"
#include "drive/sensorless_estimate.h"
#include "drive/sensorless_startup.h"
#include "drive/speed_control.h"
#include "drive/stop.h"
#include "drive/test_mode.h"
#include "math/divide.h"
#include "sensing/rotor_hold.h"

#define GAIN_SHIFT_MAX 3U /* an eighth of the gains */

/* ---- common ----------------------------------------------------------------------------------------------------- */

static void track_offsets(axis_t *axis)
{
    current_sense_track(&axis->sense, hal_adc_offsets(axis->hal, axis->index), axis->config->offset_duty_min);
}

/* Calculates the currents in the rotor frame while they are not controlled. */
static void measure(axis_t *axis)
{
    const abc_t current = current_sense_read(&axis->sense, hal_adc_currents(axis->hal, axis->index));
    axis->current_loop.current = park(clarke(current), sin_cos_of(axis->feedback.theta_e));
}

/* Dead time is compensated with FEATURE_DEAD_TIME, and always on a sensorless axis, because the observer requires it. */
static void choose_dead_time(axis_t *axis, uint32_t features)
{
    axis->current_loop.dead_time_off = (features & FEATURE_DEAD_TIME) == 0U && !axis->sensorless;
}

static void enter(axis_t *axis, substate_t substate)
{
    axis->substate = substate;
    axis->sm.entered = EVENT_TICKS;
    axis->ticks = 0;
}

/* A shaft that is still driven by its load must not start to move minutes later, when it comes to rest: the request is
 * cleared after a time. */
static void wait_for_rest(axis_t *axis)
{
    axis->ticks++;
    if (axis->ticks > axis->config->rest_ticks_max) {
        axis->ticks = 0;
        axis->enable_requested = false;
    }
}

/* ---- transitions ------------------------------------------------------------------------------------------------ */

/* READY shorts the windings. A shaft without an encoder may be turning: its outputs stay off. */
static void to_ready(axis_t *axis)
{
    axis_zero_voltage(axis, !axis->sensorless);
    sensorless_estimate_stop(axis);
    axis->fast = LOOP_FAST;
    enter(axis, SUBSTATE_READY);
}

/* Acceleration at full-scale current, encoder counts per slow tick squared, 22 fraction bits. */
static int32_t acceleration_per_current(const axis_config_t *config)
{
    const int64_t scaled = (int64_t)config->speed_observer.acceleration_per_current * encoder_lines(&config->encoder);
    return sat32(i64_over_u16(scaled, POSITION_PER_TURN / 4));
}

static void ready_align(axis_t *axis)
{
    choose_dead_time(axis, FEATURE_DEAD_TIME); /* always: the search evaluates voltages */
    if (holding_brake_fitted(axis)) {
        rotor_hold_start(&axis->search, &axis->config->rotor_search, axis->feedback.count,
                         acceleration_per_current(axis->config));
    } else {
        rotor_search_start(&axis->search, axis->feedback.count);
    }
    axis->diagnosis.stall.running = false;
    enter(axis, SUBSTATE_ALIGN);
}

static void to_spin(axis_t *axis)
{
    encoder_monitor_start(&axis->diagnosis.encoder, axis->feedback.count);
    angle_monitor_start(&axis->diagnosis.angle);
    axis->test_current = (dq_t){0, 0};
    homing_spin(axis);
    motion_start(axis);
    choose_dead_time(axis, axis->parameter.features);
    angle_check_start(axis);
    enter(axis, SUBSTATE_SPIN);
}

/* Start with the torque that the load required last. */
static void to_loaded_spin(axis_t *axis)
{
    to_spin(axis);
    if (holding_brake_fitted(axis)) {
        pi_reset(&axis->motion.speed_pi, f32_from_f16(axis->brake.load));
    }
}

static void align_spin(axis_t *axis)
{
    axis_zero_voltage(axis, true);
    axis->source->align(axis, rotor_search_angle(&axis->search));
    axis->aligned = true;
    axis->brake.load = f16_from_f32(axis->search.current);
    to_loaded_spin(axis);
}

/* Inputs of the stall test. */
static void observe_stall(axis_t *axis)
{
    observation_t *o = &axis->observation;
    o->theta_e = axis->feedback.theta_e;
    o->count = axis->feedback.count;
    o->current_ref = axis->current_ref;
}

/* Start of the stall test: locate the rotor before the fault is raised. */
static void spin_stall_test(axis_t *axis)
{
    sensorless_estimate_stop(axis);
    axis->fast = LOOP_FAST;
    choose_dead_time(axis, FEATURE_DEAD_TIME);
    observe_stall(axis);
    stall_test_start(&axis->diagnosis.stall, &axis->config->rotor_search, &axis->observation);
    axis->current_ref.d = 0;
    current_loop_set_speed(&axis->current_loop, &axis->config->current_loop, 0);
    enter(axis, SUBSTATE_ALIGN);
}

static void to_freewheel(axis_t *axis)
{
    axis_zero_voltage(axis, false);
    sensorless_estimate_stop(axis);
    axis->fast = LOOP_FAST;
    enter(axis, SUBSTATE_FREEWHEEL);
}

/* Braking with shorted windings: the current flows through the low sides only, not through the supply. */
static void spin_short(axis_t *axis)
{
    axis_short(axis);
    enter(axis, SUBSTATE_FREEWHEEL);
}

static void freewheel_align(axis_t *axis)
{
    axis_zero_voltage(axis, true);
    ready_align(axis);
}

static void ready_startup(axis_t *axis)
{
    axis_zero_voltage(axis, true);
    choose_dead_time(axis, FEATURE_DEAD_TIME);
    startup_begin(axis, motion_requested_speed(axis) < 0);
    enter(axis, SUBSTATE_STARTUP);
}

/* The test vector may move the rotor anywhere; the angle of the last search remains valid. */
static void ready_test(axis_t *axis)
{
    axis_zero_voltage(axis, true);
    choose_dead_time(axis, axis->parameter.features);
    test_mode_start(axis);
    enter(axis, SUBSTATE_TEST);
}

static void startup_spin(axis_t *axis)
{
    startup_hand_over(axis);
    axis->estimate.started_reverse = axis->estimate.speed < 0;
    axis->switching_off = false;
    axis->fast = LOOP_OBSERVED;
    enter(axis, SUBSTATE_SPIN);
}

/* ---- CALIB: offsets of the current amplifiers, outputs off -------------------------------------------------------- */
/* CALIB waits until a shaft that still coasts after a fault has stopped: READY would short its windings at full
 * speed. */

static void calib_fast(axis_t *axis)
{
    if (!axis->calibrated && axis->feedback.still) {
        axis->calibrated = current_sense_calibrate(&axis->sense, hal_adc_currents(axis->hal, axis->index));
        drive_choose_pair(axis, axis->sense.pair);
    }
}

static void calib_slow(axis_t *axis)
{
    if (!axis->calibrated || !axis->feedback.still) {
        wait_for_rest(axis);
        return;
    }
    if (current_sense_offsets_plausible(&axis->sense, axis->config->offset_tolerance)) {
        to_ready(axis);
    } else {
        axis_raise(axis, FOUND(FINDING_OFFSET_OUT_OF_RANGE));
    }
}

static void idle(axis_t *axis) { (void)axis; }

/* ---- READY: 50 % on every phase, outputs on (electrically a winding short, DRM 4.5) -------------------------------- */

static void ready_fast(axis_t *axis) { measure(axis); }

static void ready_slow(axis_t *axis)
{
    if (!axis->enable_requested) {
        return;
    }
    if (axis->command.mode == CONTROL_MODE_TEST && !axis->sensorless) {
        if (test_mode_requested(axis)) {
            ready_test(axis);
        } else {
            axis->enable_requested = false;
        }
        return;
    }
    if (axis->sensorless && motion_requested_speed(axis) == 0) {
        holding_brake_request(axis, false);
        return;
    }
    if (holding_brake_fitted(axis) && axis->aligned && !axis->sensorless) {
        to_loaded_spin(axis); /* the brake opens once the position is controlled */
    } else if (!axis->sensorless) {
        ready_align(axis);
    } else {
        holding_brake_request(axis, true); /* needed for a sensorless start; meanwhile shorted windings brake */
        if (holding_brake_is_open(axis)) {
            ready_startup(axis);
        }
    }
}

/* ---- ALIGN: rotor search and stall test --------------------------------------------------------------------------- */

static void align_fast(axis_t *axis)
{
    stall_test_t *test = &axis->diagnosis.stall;
    if (test->running) {
        drive_current(axis, test->vector_angle);
        stall_test_add(test, &axis->config->rotor_search, axis->current_loop.voltage.d);
    } else if (rotor_search_drives(&axis->search)) {
        drive_current(axis, rotor_search_angle(&axis->search));
        rotor_search_add(&axis->search, &axis->config->rotor_search, axis->current_loop.current.d,
                         axis->current_loop.voltage.q);
    }
}

/* Finding for a shaft that has not moved, or on which no torque acts. */
static finding_t search_failure(const axis_t *axis)
{
    const int32_t current_min = axis->config->winding.current_min;
    const bool requested = axis->current_ref.d > 2 * current_min;
    return (requested && f16_abs(axis->current_loop.current.d) < current_min) ? FINDING_SEARCH_END_NO_CURRENT
                                                                              : FINDING_SEARCH_NO_MOVEMENT;
}

/* One slow tick of the stall test: the vector rotates at full current. */
static void test_stall(axis_t *axis)
{
    evidence_t evidence = {0};
    observe_stall(axis);
    stall_test_step(&axis->diagnosis.stall, &axis->config->rotor_search, &axis->observation, &evidence);
    axis_raise(axis, evidence.confirmed);
}

/* Finding at the end of a search; FINDINGS during the search. */
static finding_t search_end(axis_t *axis, finding_t failure)
{
    switch (axis->search.phase) {
    case ROTOR_SEARCH_NO_COUNT:
        return FINDING_SEARCH_WITHOUT_COUNT;
    case ROTOR_SEARCH_LOW_CURRENT:
        return FINDING_SEARCH_LOW_CURRENT;
    case ROTOR_SEARCH_REVERSED:
        return FINDING_SEARCH_REVERSED;
    case ROTOR_SEARCH_NO_MOVEMENT:
        return failure;
    default:
        if (axis->ticks <= axis->config->search_ticks_max) {
            return FINDINGS;
        }
        return rotor_search_tests_direction(&axis->search, axis->feedback.count) ? FINDINGS : failure;
    }
}

static void search_step(axis_t *axis)
{
    rotor_search_t *search = &axis->search;
    if (search->phase != ROTOR_SEARCH_HOLD) {
        rotor_search_step(search, &axis->config->rotor_search, axis->feedback.count);
        return;
    }
    if (axis->enable_requested && rotor_hold_opens_brake(search)) {
        holding_brake_request(axis, true);
        search->brake_released = holding_brake_is_open(axis);
    }
    rotor_hold_step(search, &axis->config->rotor_search, axis->feedback.count);
}

static void align_slow(axis_t *axis)
{
    if (axis->diagnosis.stall.running && axis->enable_requested) {
        test_stall(axis);
        return;
    }
    if (!axis->enable_requested && holding_brake_takes_over(axis) && !holding_brake_is_closed(axis)) {
        holding_brake_request(axis, false); /* the vector holds the load until then */
        return;
    }
    const bool driven = rotor_search_drives(&axis->search);
    const finding_t failure = search_failure(axis);
    search_step(axis);
    axis->ticks++;
    axis->current_ref = (dq_t){f16_from_f32(axis->search.current), 0};
    const finding_t end = search_end(axis, failure);
    if (!axis->enable_requested) {
        to_ready(axis);
    } else if (end != FINDINGS) {
        axis_raise(axis, FOUND(end));
    } else if (axis->search.phase == ROTOR_SEARCH_FOUND) {
        align_spin(axis);
    } else if (driven && !rotor_search_drives(&axis->search)) {
        axis_zero_voltage(axis, true); /* to rest: the shorted windings brake the remaining motion */
    }
}

/* ---- SPIN: field-oriented control ---------------------------------------------------------------------------------- */

/* Sensorless: at the lower speed limit of the observer the current is reduced to 0, then the outputs are switched
 * off. */
static void fade_out(axis_t *axis)
{
    axis->switching_off = axis->switching_off || motion_too_slow(axis);
    if (axis->switching_off) {
        const frac32_t q = f32_from_f16(axis->last_i_q_ref);
        axis->current_ref.q = f16_from_f32(q - f32_clip(q, axis->config->startup.fade_step));
    }
    axis->last_i_q_ref = axis->current_ref.q;
}

/* Sensorless: run the PLL, then check whether it still follows the rotor. */
static void follow_rotor(axis_t *axis)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    sensorless_estimate_update_rotation(axis);
    sensorless_estimate_step(axis);
    back_emf_observer_set_speed(&estimate->observer, estimate->pll.integral);
    if (axis->switching_off) {
        return;
    }
    estimate->pll.backwards = estimate->pll.integral < 0;
    pll_feed_forward(&estimate->pll, &axis->config->pll, axis->current_loop.current.q, estimate->deviation,
                     estimate->rotation);
}

static void judge_observer(axis_t *axis)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    sensorless_estimate_judge(axis);
    if (axis->switching_off) {
        return;
    }
    const bool lost = estimate->reliability.failures > axis->config->reliability.hysteresis;
    const bool stands = sensorless_estimate_count_standstill(axis) > axis->config->emf_check.ticks_stand;
    if (emf_check_confirmed(&estimate->check, estimate->deviates, axis->config->emf_check.ticks_spin) || lost ||
        stands) {
        axis_raise(axis, FOUND(FINDING_OBSERVER_LOST));
    }
}

/* The observer has lost the rotor, or the drive is no longer requested. */
static void bring_to_rest(axis_t *axis)
{
    if (axis->switching_off) {
        if (axis->current_ref.q == 0) {
            to_freewheel(axis);
        }
        return;
    }
    const stop_category_t next = axis->enable_requested ? STOP_CATEGORY_HOLD : stop_step(axis);
    if (next == STOP_CATEGORY_COAST) {
        to_freewheel(axis);
    } else if (next == STOP_CATEGORY_SHORT) {
        spin_short(axis);
    }
}

/* The circle of the current limit applies to i_d first; i_q gets the remainder. */
static void bound_current(axis_t *axis)
{
    const frac16_t limit = axis->current_max.vector;
    frac16_t i_q_max = limit;
    if (axis->current_ref.d != 0) {
        const frac16_t d = f16_limit(axis->current_ref.d, limit);
        axis->current_ref.d = d;
        i_q_max = f16_sqrt(f32_mul16(limit, limit) - f32_mul16(d, d));
    }
    axis->current_ref.q = f16_limit(axis->current_ref.q, i_q_max);
}

static finding_set_t monitor_shaft(axis_t *axis)
{
    const bool full = axis->motion.saturated && !axis->motion.current_reduced; /* a reduced limit is no evidence */
    const bool opposed = (axis->feedback.speed < 0) != (axis->current_ref.q < 0);
    shaft_observation_t seen = {
        .features = axis->parameter.features,
        .speed = axis->feedback.speed,
        .speed_limit = axis->limits.speed,
        .decelerated_at_limit = full && opposed,
        .no_movement_at_limit = full && axis->feedback.still,
        .following_error = motion_following_error(axis),
    };
    if ((seen.features & (FEATURE_FOLLOWING_ERROR | FEATURE_OVER_SPEED)) != 0U) {
        seen.following_error_max = axis->parameter.following_error;
        seen.over_speed_max = axis->parameter.over_speed;
    }
    return shaft_monitor_step(&axis->diagnosis.shaft, &axis->config->shaft, &seen);
}

/* Stalled, runaway or following error. Before STALLED is raised, the stall test runs. */
static void judge_shaft(axis_t *axis, finding_set_t findings)
{
    const finding_set_t findings_enabled = fault_enabled(findings, axis->latch.enabled);
    if (findings_enabled == FOUND(FINDING_SHAFT_BLOCKED) && axis->enable_requested && !axis->sensorless) {
        spin_stall_test(axis);
    } else {
        axis_raise(axis, findings_enabled);
    }
}

static void spin_slow(axis_t *axis)
{
    motion_step(axis);
    if (axis->test_current.d != 0 || axis->test_current.q != 0) {
        axis->current_ref.d = f16_add(axis->current_ref.d, axis->test_current.d);
        axis->current_ref.q = f16_add(axis->current_ref.q, axis->test_current.q);
        if (axis->test_signal.point == TEST_POINT_TORQUE) {
            axis->current_ref.q = f16_limit(axis->current_ref.q, axis->test_signal.limit);
        }
    }
    if (axis->sensorless) {
        axis->current_ref.d = f16_add(axis->current_ref.d, startup_reduce_i_d(axis));
        fade_out(axis);
    }
    bound_current(axis);
    if (axis->current_loop.limited) {
        axis_report(axis, LIMIT_VOLTAGE);
        axis->current_loop.limited = false;
    }
    if (axis->motion.gain_shift != 0U || axis->motion.forced) {
        axis_report(axis, LIMIT_OSCILLATION);
    }
    if ((axis->sm.ctrl & SM_CTRL_FAULT) == 0U) {
        bring_to_rest(axis);
    }
}

static void spin_estimate(axis_t *axis)
{
    track_offsets(axis);
    choose_dead_time(axis, axis->parameter.features);
    current_loop_set_speed(&axis->current_loop, &axis->config->current_loop, f16_from_f32(axis->feedback.speed));
    if (axis->sensorless) {
        follow_rotor(axis);
    } else if (axis->estimate.runs || (axis->parameter.features & FEATURE_ANGLE_CHECK) != 0U) {
        angle_check_step(axis);
    }
}

/* Reduce the gains. If an oscillation remains as it was, the load forces it, e.g. by cogging: the full gains oppose it
 * best. A large one stops the axis. */
static void calm(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const uint16_t swing = axis->diagnosis.oscillation.swing;
    if (m->gain_shift == 0U && !m->forced) {
        m->first_swing = swing;
    }
    if (!m->forced && m->gain_shift < GAIN_SHIFT_MAX) {
        speed_control_retune(axis, axis->config, (uint16_t)(m->gain_shift + 1U));
    } else if (swing > (uint16_t)axis->current_max.q) {
        axis_raise(axis, FOUND(FINDING_OSCILLATION));
    } else if (!m->forced && swing > m->first_swing / 2U) {
        speed_control_retune(axis, axis->config, 0);
        m->forced = true;
    }
}

/* Current that an oscillation has, or would have with full gains: then one limit serves all gains. It is measured,
 * because the current loop may be the one that oscillates. The feed-forward against torque ripple is no oscillation. */
static frac16_t current_with_full_gains(const axis_t *axis)
{
    const motion_state_t *m = &axis->motion;
    const frac16_t current = f16_sub(axis->current_loop.current.q, f16_from_f32(axis->ripple.applied));
    if (m->gain_shift == 0U) {
        return current;
    }
    const pi_gains_t *full = speed_control_full_gains(axis, axis->config);
    const frac32_t error = f32_sub(m->speed_ref, axis->feedback.speed);
    return f16_add(current, f16_from_f32(f32_gain(error, full->kp - m->speed_gains->kp)));
}

/* A host may command a torque that alternates. */
static void judge_oscillation(axis_t *axis)
{
    oscillation_monitor_t *monitor = &axis->diagnosis.oscillation;
    const bool commanded = axis->motion.motion == MOTION_TORQUE || axis->test_signal.point != TEST_POINT_NONE;
    if (commanded || (axis->latch.enabled & FAULT_OSCILLATION) == 0U) {
        oscillation_monitor_restart(monitor);
        return;
    }
    if (oscillation_monitor_step(monitor, current_with_full_gains(axis))) {
        calm(axis);
    }
}

static void spin_check(axis_t *axis)
{
    if (axis->sensorless) {
        judge_observer(axis);
    } else {
        angle_check_judge(axis);
    }
    if (axis->motion.underrun && (axis->parameter.features & FEATURE_STARVED) != 0U) {
        axis_raise(axis, FOUND(FINDING_HOST_SILENT));
    }
    judge_oscillation(axis);
    const finding_set_t findings = monitor_shaft(axis);
    if (findings != 0U) {
        judge_shaft(axis, findings);
    }
}

/* ---- STARTUP: a sensorless axis, from rest to the observer's minimum speed ----------------------------------------- */

static void startup_slow_state(axis_t *axis)
{
    if (!axis->enable_requested || motion_requested_speed(axis) == 0) {
        to_freewheel(axis);
    }
}

static void startup_estimate(axis_t *axis)
{
    track_offsets(axis);
    sensorless_estimate_update_rotation(axis);
    sensorless_estimate_step(axis);
    back_emf_observer_set_speed(&axis->estimate.observer, axis->estimate.pll.integral);
    startup_step(axis);
}

static void startup_check(axis_t *axis)
{
    sensorless_estimate_judge(axis);
    switch (startup_judge(axis)) {
    case STARTUP_DONE:
        startup_spin(axis);
        break;
    case STARTUP_FAILED:
        axis_raise(axis, FOUND(startup_failure(axis)));
        break;
    default:
        break;
    }
}

/* ---- TEST: a current vector along an imposed angle ----------------------------------------------------------------- */

static void test_slow(axis_t *axis)
{
    if (test_mode_requested(axis)) {
        test_mode_slow(axis);
        return;
    }
    axis->enable_requested = false; /* the next motion needs a new enable command */
    axis->fast = LOOP_FAST;
    if (stop_may_short(axis)) {
        to_ready(axis);
    } else {
        to_freewheel(axis);
    }
}

static void test_estimate(axis_t *axis)
{
    track_offsets(axis);
    choose_dead_time(axis, axis->parameter.features);
}

/* An imposed vector gives no feedback of the shaft: only over-speed is checked. */
static void test_check(axis_t *axis)
{
    const shaft_observation_t seen = {
        .features = axis->parameter.features & FEATURE_OVER_SPEED,
        .speed = axis->feedback.speed,
        .speed_limit = axis->limits.speed,
        .over_speed_max = axis->parameter.over_speed,
    };
    axis_raise(axis, shaft_monitor_step(&axis->diagnosis.shaft, &axis->config->shaft, &seen));
}

/* ---- FREEWHEEL: outputs off, or first shorted windings, until the rotor is at rest -------------------------------- */

static void freewheel_fast(axis_t *axis)
{
    measure(axis);
    if (axis->shorted && stop_short_overloaded(axis)) {
        axis_zero_voltage(axis, false);
    }
}

static void freewheel_slow(axis_t *axis)
{
    if (axis->shorted) {
        if (stop_short_over(axis)) {
            axis_zero_voltage(axis, false);
        }
        return;
    }
    if (!axis->feedback.still) {
        wait_for_rest(axis);
        return;
    }
    if (axis->enable_requested && !axis->sensorless && !holding_brake_fitted(axis)) {
        freewheel_align(axis);
    } else {
        to_ready(axis);
    }
}

/* ---- the table ------------------------------------------------------------------------------------------------------ */

const axis_function_t run_table[7][6] = {
    [SUBSTATE_CALIB] = {calib_fast, calib_slow, calib_fast, idle, idle, calib_fast},
    [SUBSTATE_READY] = {ready_fast, ready_slow, ready_fast, track_offsets, idle, ready_fast},
    /* rotor search, or stall test (spin_stall_test) */
    [SUBSTATE_ALIGN] = {align_fast, align_slow, align_fast, track_offsets, idle, align_fast},
    [SUBSTATE_SPIN] = {spin_fast, spin_slow, spin_observed_fast, spin_estimate, spin_check, spin_test_signal_fast},
    [SUBSTATE_FREEWHEEL] = {freewheel_fast, freewheel_slow, freewheel_fast, track_offsets, idle, freewheel_fast},
    [SUBSTATE_STARTUP] = {startup_fast, startup_slow_state, startup_fast, startup_estimate, startup_check,
                          startup_fast},
    [SUBSTATE_TEST] = {test_mode_fast, test_slow, test_mode_fast, test_estimate, test_check, test_mode_signal_fast},
};

void run_state_enter(axis_t *axis)
{
    axis_zero_voltage(axis, false);
    current_sense_reset(&axis->sense);
    axis->calibrated = false;
    axis->fast = LOOP_FAST;
    axis->switching_off = false;
    sensorless_estimate_stop(axis);
    drive_choose_pair(axis, axis->sense.pair);
    enter(axis, SUBSTATE_CALIB);
}

bool run_state_may_leave(const axis_t *axis)
{
    return axis->substate == SUBSTATE_CALIB || axis->substate == SUBSTATE_READY;
}
