/* run_states.c - the sub-states of RUN, each with a fast and a slow function, and their transitions (DRM 4.5, F37). */
#include "drive/angle_check.h"
#include "drive/axis_states.h"
#include "drive/current_drive.h"
#include "drive/motion.h"

/* ---- common ----------------------------------------------------------------------------------------------------- */

static void track_offsets(axis_t *axis)
{
    current_sense_track(&axis->sense, hal_adc_offsets(axis->hal, axis->index), axis->config->offset_duty_least);
}

/* Currents in the rotor frame while nothing is controlled. */
static void measure(axis_t *axis)
{
    const abc_t current = current_sense_read(&axis->sense, hal_adc_currents(axis->hal, axis->index));
    axis->current_loop.current = park(clarke(current), sin_cos(axis->feedback.theta_e));
}

/* Dead time is compensated if that is among `features`; the observer of a sensorless axis cannot do without. */
static void choose_dead_time(axis_t *axis, uint16_t features)
{
    axis->current_loop.dead_time_off = (features & FEATURE_DEAD_TIME) == 0U && !axis->sensorless;
}

static void enter(axis_t *axis, substate_t substate)
{
    axis->substate = substate;
    axis->ticks = 0;
}

/* A shaft that something keeps turning must not start to move by itself, minutes later, when it comes to rest. */
static void wait_for_rest(axis_t *axis)
{
    axis->ticks++;
    if (axis->ticks > axis->config->rest_ticks_most) {
        axis->ticks = 0;
        axis->requested = false;
    }
}

/* ---- transitions ------------------------------------------------------------------------------------------------ */

/* READY shorts the windings. A shaft without an encoder may turn, for all one knows: its outputs stay off. */
static void to_ready(axis_t *axis)
{
    axis_zero_voltage(axis, !axis->sensorless);
    estimate_stop(axis);
    axis->fast = LOOP_FAST;
    enter(axis, SUBSTATE_READY);
}

static void ready_align(axis_t *axis)
{
    choose_dead_time(axis, FEATURE_DEAD_TIME); /* always: the search looks at voltages */
    rotor_search_start(&axis->search, axis->feedback.position);
    axis->proof.runs = false;
    enter(axis, SUBSTATE_ALIGN);
}

static void align_spin(axis_t *axis)
{
    axis_zero_voltage(axis, true);
    axis->source->align(axis, rotor_search_angle(&axis->search));
    encoder_watch_start(&axis->encoder_watch, axis->feedback.position);
    axis->angle_watch = (angle_watch_t){0};
    motion_start(axis);
    choose_dead_time(axis, axis->features);
    angle_check_start(axis);
    enter(axis, SUBSTATE_SPIN);
}

/* Before a shaft is called stalled: where is the rotor? */
static void spin_align(axis_t *axis)
{
    estimate_stop(axis);
    axis->fast = LOOP_FAST;
    choose_dead_time(axis, FEATURE_DEAD_TIME);
    stall_proof_start(axis);
    enter(axis, SUBSTATE_ALIGN);
}

static void to_freewheel(axis_t *axis)
{
    axis_zero_voltage(axis, false);
    estimate_stop(axis);
    axis->fast = LOOP_FAST;
    enter(axis, SUBSTATE_FREEWHEEL);
}

/* Braked by its own windings: the low sides see the current, the supply does not. */
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
    startup_begin(axis, motion_wanted_speed(axis) < 0);
    enter(axis, SUBSTATE_STARTUP);
}

static void startup_spin(axis_t *axis)
{
    startup_hand_over(axis);
    axis->estimate.astern = axis->estimate.speed < 0;
    axis->leaving = false;
    axis->fast = LOOP_OBSERVED;
    enter(axis, SUBSTATE_SPIN);
}

/* ---- CALIB: offsets of the current amplifiers, outputs off -------------------------------------------------------- */
/* A coasting shaft, left over from a fault, is waited for here: READY would short its windings at full speed. */

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
        axis_raise(axis, FAULT_CURRENT_OFFSET);
    }
}

/* ---- READY: 50 % on every phase, outputs on (electrically a winding short; the seed wants it) ---------------------- */

static void ready_fast(axis_t *axis) { measure(axis); }

static void ready_slow(axis_t *axis)
{
    track_offsets(axis);
    if (!axis->requested) {
        return;
    }
    if (!axis->sensorless) {
        ready_align(axis);
    } else if (motion_wanted_speed(axis) != 0) {
        ready_startup(axis);
    }
}

/* ---- ALIGN: where is the rotor? ----------------------------------------------------------------------------------- */

static void align_fast(axis_t *axis)
{
    if (axis->proof.runs) {
        stall_proof_fast(axis);
    } else if (rotor_search_drives(&axis->search)) {
        drive_current(axis, rotor_search_angle(&axis->search));
        rotor_search_watch(&axis->search, &axis->config->rotor_search, axis->current_loop.current.d,
                           axis->current_loop.voltage.q);
    }
}

/* A shaft that does not move, or is not pulled at all. */
static fault_set_t search_failure(const axis_t *axis)
{
    const int32_t silent = axis->config->phases.silent;
    const bool asked = axis->current_ref.d > 2 * silent;
    return (asked && f16_abs(axis->current_loop.current.d) < silent) ? FAULT_PHASE_LOST : FAULT_ROTOR_SEARCH;
}

/* A search that cannot go on ends, whether anybody wants to know its particular reason or not. */
static void end_search(axis_t *axis, fault_set_t reason)
{
    axis_raise(axis, axis_fault_or(axis, reason, FAULT_ROTOR_SEARCH));
}

static void align_slow(axis_t *axis)
{
    track_offsets(axis);
    if (axis->proof.runs && axis->requested) {
        stall_proof_slow(axis);
        return;
    }
    const bool driven = rotor_search_drives(&axis->search);
    const fault_set_t failure = search_failure(axis);
    rotor_search_step(&axis->search, &axis->config->rotor_search, axis->feedback.position);
    axis->ticks++;
    axis->current_ref = (dq_t){f16_from_f32(axis->search.current), 0};
    if (!axis->requested) {
        to_ready(axis);
    } else if (axis->search.phase == ROTOR_SEARCH_BLIND) {
        end_search(axis, FAULT_ENCODER_LOST);
    } else if (axis->search.phase == ROTOR_SEARCH_STARVED) {
        end_search(axis, phase_watch_or(axis, FAULT_PHASE_LOST));
    } else if (axis->search.phase == ROTOR_SEARCH_REVERSED) {
        end_search(axis, phase_watch_rather(axis, FAULT_ENCODER_REVERSED));
    } else if (axis->search.phase == ROTOR_SEARCH_HELD || axis->ticks > axis->config->search_ticks_most) {
        end_search(axis, failure);
    } else if (axis->search.phase == ROTOR_SEARCH_FOUND) {
        align_spin(axis);
    } else if (driven && !rotor_search_drives(&axis->search)) {
        axis_zero_voltage(axis, true); /* rest: the shorted windings brake what is left */
    }
}

/* ---- SPIN: field-oriented control ---------------------------------------------------------------------------------- */

static void spin_fast(axis_t *axis) { drive_current(axis, axis->feedback.theta_e); }

static void spin_observed_fast(axis_t *axis) { drive_observed(axis, axis->feedback.theta_e); }

/* Sensorless: the speed has come down to where the observer ends. The current goes first, then the outputs. */
static void leave_slowly(axis_t *axis)
{
    axis->leaving = axis->leaving || motion_too_slow(axis);
    if (axis->leaving) {
        const frac32_t q = f32_from_f16(axis->current_q_left);
        axis->current_ref.q = f16_from_f32(q - f32_clip(q, axis->config->startup.fade_step));
    }
    axis->current_q_left = axis->current_ref.q;
}

static void spin_sensorless(axis_t *axis)
{
    estimate_t *estimate = &axis->estimate;
    axis->current_ref.d = f16_add(axis->current_ref.d, startup_fade(axis));
    leave_slowly(axis);
    if (axis->leaving) {
        return;
    }
    estimate->pll.backwards = estimate->pll.integral < 0;
    pll_push(&estimate->pll, &axis->config->pll, axis->current_loop.current.q, estimate->deviation, estimate->turned);
    const bool lost = estimate->reliability.failures > axis->config->reliability.hysteresis;
    const bool stands = estimate_standing(axis) > axis->config->emf_check.ticks_stand;
    if (emf_check_lasts(&estimate->check, estimate->deviates, axis->config->emf_check.ticks_spin) || lost || stands) {
        axis_raise(axis, phase_watch_rather(axis, FAULT_SPEED_FEEDBACK));
    }
}

/* The observer sees the rotor no more, or the drive is not wanted any more. */
static void bring_to_rest(axis_t *axis)
{
    if (axis->leaving) {
        if (axis->current_ref.q == 0) {
            to_freewheel(axis);
        }
        return;
    }
    const stop_category_t next = axis->requested ? STOP_CATEGORY_HOLD : stop_step(axis);
    if (next == STOP_CATEGORY_COAST) {
        to_freewheel(axis);
    } else if (next == STOP_CATEGORY_SHORT) {
        spin_short(axis);
    }
}

static void spin_slow(axis_t *axis)
{
    track_offsets(axis);
    choose_dead_time(axis, axis->features);
    current_loop_turn(&axis->current_loop, &axis->config->current_loop, f16_from_f32(axis->feedback.speed));
    motion_step(axis);
    if (encoder_watch_is_asking(&axis->encoder_watch)) {
        const dq_t asked = encoder_watch_asks(axis);
        axis->current_ref.d = f16_add(axis->current_ref.d, asked.d);
        axis->current_ref.q = f16_add(axis->current_ref.q, asked.q);
    }
    if (axis->sensorless) {
        spin_sensorless(axis);
    } else if (axis->estimate.runs || (axis->features & FEATURE_ANGLE_CHECK) != 0U) {
        angle_check_step(axis);
    }
    if (axis->current_loop.limited) {
        axis->active_limits = (uint16_t)(axis->active_limits | LIMIT_VOLTAGE);
        axis->current_loop.limited = false;
    }
    fault_set_t faults = supervision_step(axis) & axis->faults_enabled;
    if (faults == FAULT_STALLED && axis->requested && !axis->sensorless) {
        spin_align(axis);
        return;
    }
    if (faults == FAULT_RUNAWAY) {
        const fault_set_t rather = phase_watch_rather(axis, angle_watch_rather(axis, faults));
        faults = axis_fault_or(axis, rather, faults); /* whatever it is called, it has to stop */
    }
    axis_raise(axis, faults);
    if ((axis->sm.ctrl & SM_CTRL_FAULT) == 0U) {
        bring_to_rest(axis);
    }
}

/* ---- STARTUP: a sensorless axis, from rest to where the observer sees the rotor ------------------------------------ */

static void startup_slow_state(axis_t *axis)
{
    track_offsets(axis);
    if (!axis->requested || motion_wanted_speed(axis) == 0) {
        to_freewheel(axis);
        return;
    }
    switch (startup_slow(axis)) {
    case STARTUP_DONE:
        startup_spin(axis);
        break;
    case STARTUP_FAILED:
        axis_raise(axis, startup_failure(axis));
        break;
    default:
        break;
    }
}

/* ---- FREEWHEEL: outputs off until the rotor is still; or shorted windings, which become the same ------------------- */

static void freewheel_fast(axis_t *axis)
{
    measure(axis);
    if (axis->shorted && stop_short_overloaded(axis)) {
        axis_zero_voltage(axis, false);
    }
}

static void freewheel_slow(axis_t *axis)
{
    track_offsets(axis);
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
    if (axis->requested && !axis->sensorless) {
        freewheel_align(axis);
    } else {
        to_ready(axis);
    }
}

/* ---- the table ------------------------------------------------------------------------------------------------------ */

static const axis_function_t run_table[6][3] = {
    [SUBSTATE_CALIB] = {calib_fast, calib_slow, calib_fast},
    [SUBSTATE_READY] = {ready_fast, ready_slow, ready_fast},
    [SUBSTATE_ALIGN] = {align_fast, align_slow, align_fast},
    [SUBSTATE_SPIN] = {spin_fast, spin_slow, spin_observed_fast},
    [SUBSTATE_FREEWHEEL] = {freewheel_fast, freewheel_slow, freewheel_fast},
    [SUBSTATE_STARTUP] = {startup_fast, startup_slow_state, startup_fast},
};

void run_state_step(axis_t *axis) { run_table[axis->substate][axis->loop](axis); }

void run_state_enter(axis_t *axis)
{
    axis_zero_voltage(axis, false);
    current_sense_reset(&axis->sense);
    axis->calibrated = false;
    axis->fast = LOOP_FAST;
    axis->leaving = false;
    estimate_stop(axis);
    drive_choose_pair(axis, axis->sense.pair);
    enter(axis, SUBSTATE_CALIB);
}

bool run_state_may_leave(const axis_t *axis)
{
    return axis->substate == SUBSTATE_CALIB || axis->substate == SUBSTATE_READY;
}
