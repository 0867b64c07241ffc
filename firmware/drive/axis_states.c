/* axis_states.c - main states FAULT, INIT, STOP, RUN and their transitions (DRM 4.5). */
#include "drive/axis_states.h"

#include "drive/outputs.h"
#include "drive/run_states.h"

/* ---- states --------------------------------------------------------------------------------------------------- */

static void state_fault(axis_t *axis, axis_loop_t loop)
{
    (void)loop;
    hal_pwm_enable(axis->hal, axis->index, false);
}

static void state_init(axis_t *axis, axis_loop_t loop)
{
    if (loop != LOOP_SLOW) {
        return;
    }
    axis->ticks++;
    if (axis->ticks >= axis->config->settle_ticks) {
        axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_INIT_DONE);
    }
}

static void state_stop(axis_t *axis, axis_loop_t loop)
{
    if (loop == LOOP_SLOW && axis->enable_requested) {
        axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_START);
    }
}

static void state_run(axis_t *axis, axis_loop_t loop)
{
    run_state_step(axis, loop);
    if (loop == LOOP_SLOW && !axis->enable_requested) {
        axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_STOP);
    }
}

/* ---- transitions ---------------------------------------------------------------------------------------------- */

/* Faults of the supply, the host or the machine, after which the encoder count is still valid. */
#define ANGLE_HOLDS                                                                                                    \
    (FAULT_OVER_VOLTAGE | FAULT_UNDER_VOLTAGE | FAULT_HOST_SILENT | FAULT_FOLLOWING_ERROR | FAULT_OVER_SPEED |         \
     FAULT_OVER_TEMPERATURE | FAULT_MOTOR_TEMPERATURE | FAULT_HOMING | FAULT_ENABLE_INPUT | FAULT_LIMIT_SWITCH)

static void off(axis_t *axis)
{
    axis_zero_voltage(axis, false);
    axis->enable_requested = false;
    axis->aligned = axis->aligned && (axis->latch.captured & ~(fault_set_t)ANGLE_HOLDS) == 0U;
}

static void fault_init(axis_t *axis)
{
    axis->source->resync(axis);
    axis->ticks = 0;
}

static void init_stop(axis_t *axis) { axis->ticks = 0; }

static void stop_init(axis_t *axis) { axis->ticks = 0; }

static void stop_run(axis_t *axis)
{
    /* The reference design switches the outputs on here; CALIB, which follows at once, needs them off. They stay off. */
    run_state_enter(axis);
    axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_RUN_ACK);
}

static void run_stop(axis_t *axis)
{
    if (axis->enable_requested) {
        /* Requested again before the stop was complete. */
        axis->sm.ctrl = (uint16_t)(axis->sm.ctrl & (uint16_t)~SM_CTRL_STOP);
    } else if (run_state_may_leave(axis)) {
        axis_zero_voltage(axis, false);
        axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_STOP_ACK);
    }
}

static const sm_states_t states = {state_fault, state_init, state_stop, state_run};

static const sm_transitions_t transitions = {
    .fault_init = fault_init,
    .init_fault = off,
    .init_stop = init_stop,
    .stop_fault = off,
    .stop_init = stop_init,
    .stop_run = stop_run,
    .run_fault = off,
    .run_stop = run_stop,
};

void axis_states_init(axis_t *axis)
{
    axis->sm.states = &states;
    axis->sm.transitions = &transitions;
    axis->sm.ctrl = SM_CTRL_NONE;
    axis->sm.state = STATE_INIT;
    axis->substate = SUBSTATE_CALIB;
    axis->enable_requested = false;
    axis->stop = (stop_t){.category = STOP_CATEGORY_COAST};
    axis->stop_faults = 0;
    axis->active_limits = 0;
    axis->ticks = 0;
    axis_zero_voltage(axis, false);
}
