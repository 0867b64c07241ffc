/* axis.c - functions common to all states of an axis: measurement, monitoring, requests and clearing of faults. */
#include "drive/axis.h"

#include <string.h>

#include "diagnosis/fault_isolate.h"
#include "drive/axis_field_weakening.h"
#include "drive/axis_states.h"
#include "drive/feedback.h"
#include "drive/holding_brake.h"
#include "drive/homing.h"
#include "drive/inputs.h"
#include "drive/limits.h"
#include "drive/monitors.h"
#include "drive/motion.h"
#include "drive/ripple_forward.h"
#include "drive/run_states.h"
#include "drive/soft_limits.h"
#include "drive/speed_control.h"
#include "drive/stop.h"
#include "drive/test_signal.h"
#include "drive/winding_protection.h"

#define U_DC_FILTER_SHIFT 4 /* time constant: 16 PWM periods */
#define BUS_CODE_SHIFT 3    /* 12-bit code to Q1.15 (DRM E46, E47) */

void axis_init(axis_t *axis, const axis_config_t *config, const parameter_block_t *parameter, hal_t *hal,
               uint16_t index, fault_record_t *record, const uint32_t *clock)
{
    (void)memset(axis, 0, sizeof *axis);
    fault_latch_init(&axis->latch, record, clock);
    axis->diagnosis.bus = (bus_monitor_t){config->u_dc_max, config->u_dc_min};
    axis->config = config;
    axis->hal = hal;
    axis->index = index;
    axis->source = &encoder_feedback;
    parameters_of_axis(&axis->parameter, parameter, index);
    axis->limits.speed = axis->parameter.speed_limit;
    axis->limits.acceleration = axis->parameter.acceleration_limit;
    axis->limits.i_q = axis->parameter.i_q_limit;
    axis->limits.position_min = INT32_MIN;
    axis->limits.position_max = INT32_MAX;
    axis->written_limits = axis->limits;
    axis->limits_fresh = false;
    axis->path_limits = soft_limits_path(config, &axis->limits, config->path_omega_n_ts);
    winding_protection_init(axis);
    axis->regen_derating = FRAC16_MAX;
    current_sense_reset(&axis->sense);
    hal_pwm_enable(hal, index, false);
    hal_adc_select(hal, index, axis->sense.pair);
    axis->motion.position_gain = config->position_gain;
    speed_control_start(axis);
    axis->fast = LOOP_FAST;
    homing_init(axis);
    axis->source->reset(axis);
    axis_states_init(axis);
    inputs_configure(axis);
}

/* Select the source of angle and speed: not in motion, and no observer without its constants. */
static void choose_source(axis_t *axis)
{
    const bool sensorless = axis->parameter.feedback == FEEDBACK_KIND_OBSERVER && axis_observable(axis);
    if (sensorless != axis->sensorless && axis->sm.state != STATE_RUN) {
        axis->sensorless = sensorless;
        axis->source = sensorless ? &observer_feedback : &encoder_feedback;
        axis->source->reset(axis);
        homing_forget(axis);
    }
}

static void filter_bus(axis_t *axis)
{
    const frac32_t sample = (frac32_t)((uint32_t)hal_adc_bus(axis->hal) << (BUS_CODE_SHIFT + 16));
    frac32_t filter = axis->u_dc_filter;
    if (filter == 0) {
        filter = sample; /* start at the first sample: a rise from 0 would look like under-voltage */
    }
    filter += asr32(sample - filter, U_DC_FILTER_SHIFT);
    axis->u_dc_now = sample;
    axis->u_dc_filter = filter;
    axis->u_dc = f16_from_f32(filter);
}

/* Findings whose cause is present now. */
static finding_set_t present(const axis_t *axis)
{
    return monitor_bus_now(axis) | (axis->diagnosis.heat_sink.hot ? FOUND(FINDING_HEAT_SINK_HOT) : 0U) |
           winding_model_findings(&axis->diagnosis.winding);
}

/* A present finding stops the axis at once, or, if its fault is handled by a stop, after the axis has come to rest. */
static void enter_fault_if_requested(axis_t *axis)
{
    axis_raise(axis, present(axis));
    if (axis->sm.state != STATE_FAULT && (axis->latch.captured & ~axis->stop_faults) != 0U) {
        axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_FAULT);
    }
}

void axis_monitor_currents(axis_t *axis) { monitor_currents(axis); }

void axis_monitor_encoder(axis_t *axis) { monitor_encoder(axis); }

void axis_fast(axis_t *axis)
{
    filter_bus(axis);
    axis->source->fast(axis);
    if (monitor_fault_possible(axis)) {
        enter_fault_if_requested(axis);
    }
    if (axis->sm.state == STATE_RUN && (axis->sm.ctrl & (SM_CTRL_FAULT | SM_CTRL_STOP)) == 0U) {
        run_state_step(axis, axis->fast); /* without sm_step: the fast loop is time-critical */
        if ((axis->sm.ctrl & SM_CTRL_FAULT) == 0U) {
            return; /* the usual case */
        }
    }
    sm_step(&axis->sm, axis, axis->fast);
}

/* A written enable requests the drive, a written 0 withdraws the request; a fault cancels it. */
static void take_requests(axis_t *axis)
{
    const axis_command_t *command = &axis->command;
    if (axis->sm.state == STATE_FAULT) {
        axis->enable_requested = false;
        axis->stop_faults = 0;
    } else if ((command->fresh & FRESH_ENABLE) != 0U) {
        if (command->enable) {
            axis->enable_requested = axis->stop_faults == 0U && inputs_permit(axis);
        } else {
            stop_begin(axis, (stop_category_t)axis->parameter.on_disable);
        }
    }
    const stop_category_t on_quick_stop = (stop_category_t)axis->parameter.on_quick_stop;
    if ((command->fresh & FRESH_QUICK_STOP) != 0U && command->quick_stop && on_quick_stop != STOP_CATEGORY_HOLD) {
        stop_begin(axis, on_quick_stop);
    }
    if ((command->fresh & FRESH_CLEAR_FAULTS) != 0U && axis->sm.state == STATE_FAULT) {
        hal_over_current_clear(axis->hal, axis->index);
        const fault_set_t broken = axis->latch.pending & FAULT_CURRENT_SENSE & axis->latch.enabled;
        fault_latch_clear(&axis->latch, broken | fault_names(present(axis)));
        if (axis->latch.captured == 0U) {
            axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_FAULT_CLEAR);
        }
    }
}

static void age_set_point(axis_command_t *command)
{
    if (command->fresh != 0U && axis_set_point_fresh(command)) {
        command->age = 0;
    } else if (command->age < UINT16_MAX) {
        command->age++;
    }
}

void axis_slow(axis_t *axis)
{
    age_set_point(&axis->command);
    axis->active_limits = axis->bus_limits | axis->input_limits;
    if (!axis->source->slow(axis)) {
        axis_raise(axis, FOUND(FINDING_COUNT_CONTRADICTS_INDEX));
    }
    if (axis->limits_fresh) {
        limits_tighten(axis);
    }
    if (axis->command.fresh != 0U || axis->sm.state == STATE_FAULT) {
        take_requests(axis);
    }
    choose_source(axis);
    if (axis->sensorless && !(axis->sm.state == STATE_RUN && axis->substate == SUBSTATE_SPIN)) {
        motion_accept_speed(axis);
    }
    if (axis->stop_faults != 0U && !stop_is_controllable(axis)) {
        axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_FAULT); /* at rest: switch the outputs off now */
        axis->stop_faults = 0;
    }
    sm_step(&axis->sm, axis, LOOP_SLOW);
    axis->command.fresh = 0; /* cleared here because the latch may be skipped */
}

void axis_estimate(axis_t *axis) { sm_step(&axis->sm, axis, LOOP_ESTIMATE); }

void axis_plan(axis_t *axis, uint32_t tick) { motion_plan(axis, tick); }

void axis_check(axis_t *axis)
{
    sm_step(&axis->sm, axis, LOOP_CHECK);
    if (axis->path_limits.stale) {
        limits_retune(axis);
    }
}

void axis_protect(axis_t *axis)
{
    inputs_step(axis);
    holding_brake_step(axis);
    homing_step(axis);
    winding_protection_step(axis);
    axis_field_weakening_step(axis); /* within the thermal limit of the winding */
}

void axis_test_signal(axis_t *axis) { test_signal_step(axis); }

void axis_forward(axis_t *axis) { ripple_forward_step(axis); }

void axis_edge(axis_t *axis) { axis->source->edge(axis); }

void axis_over_current_trip(axis_t *axis)
{
    /* The hardware has opened the switches. The fast loop reads its latch and raises the fault; here, above every other
     * interrupt, nothing else may be touched. */
    hal_pwm_enable(axis->hal, axis->index, false);
}
