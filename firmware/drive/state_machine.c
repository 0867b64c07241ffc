#include "drive/state_machine.h"

#include <stdbool.h>

static bool take(sm_t *sm, uint16_t flag)
{
    if ((sm->ctrl & flag) == 0U) {
        return false;
    }
    sm->ctrl = (uint16_t)(sm->ctrl & (uint16_t)~flag);
    return true;
}

static void enter(sm_t *sm, state_t state)
{
    sm->state = state;
    sm->entered = EVENT_TICKS;
}

/* A fault leads to FAULT at once and clears all requests: the drive never restarts without a new command. */
static bool enter_fault_if_requested(sm_t *sm, struct axis *axis, axis_function_t to_fault)
{
    if ((sm->ctrl & SM_CTRL_FAULT) == 0U) {
        return false;
    }
    to_fault(axis);
    sm->ctrl = SM_CTRL_NONE;
    enter(sm, STATE_FAULT);
    return true;
}

/* Call the function of a state unless there is a fault; false if there was one before the call, or if the call raised
 * one. */
static bool run_unless_fault(sm_t *sm, struct axis *axis, axis_loop_t loop, state_function_t state,
                             axis_function_t to_fault)
{
    if ((sm->ctrl & SM_CTRL_FAULT) == 0U) {
        state(axis, loop);
    }
    return !enter_fault_if_requested(sm, axis, to_fault);
}

static void step_fault(sm_t *sm, struct axis *axis, axis_loop_t loop)
{
    sm->states->fault(axis, loop);
    (void)take(sm, SM_CTRL_FAULT);
    if (take(sm, SM_CTRL_FAULT_CLEAR)) {
        sm->transitions->fault_init(axis);
        sm->ctrl = SM_CTRL_NONE;
        enter(sm, STATE_INIT);
    }
}

static void step_init(sm_t *sm, struct axis *axis, axis_loop_t loop)
{
    if (!run_unless_fault(sm, axis, loop, sm->states->init, sm->transitions->init_fault)) {
        return;
    }
    if (take(sm, SM_CTRL_INIT_DONE)) {
        sm->transitions->init_stop(axis);
        enter(sm, STATE_STOP);
    }
}

static void step_stop(sm_t *sm, struct axis *axis, axis_loop_t loop)
{
    if (!run_unless_fault(sm, axis, loop, sm->states->stop, sm->transitions->stop_fault)) {
        return;
    }
    if ((sm->ctrl & SM_CTRL_START) != 0U) {
        sm->transitions->stop_run(axis);
        if (take(sm, SM_CTRL_RUN_ACK)) {
            (void)take(sm, SM_CTRL_START);
            enter(sm, STATE_RUN);
        }
    }
}

static void step_run(sm_t *sm, struct axis *axis, axis_loop_t loop)
{
    if ((sm->ctrl & SM_CTRL_FAULT) == 0U) {
        sm->states->run(axis, loop);
        if ((sm->ctrl & (SM_CTRL_FAULT | SM_CTRL_STOP)) == 0U) {
            return; /* the usual case */
        }
    }
    if (enter_fault_if_requested(sm, axis, sm->transitions->run_fault)) {
        return;
    }
    sm->transitions->run_stop(axis);
    if (take(sm, SM_CTRL_STOP_ACK)) {
        (void)take(sm, SM_CTRL_STOP);
        enter(sm, STATE_STOP);
    }
}

void sm_step(sm_t *sm, struct axis *axis, axis_loop_t loop)
{
    if (sm->state == STATE_RUN) {
        step_run(sm, axis, loop); /* first, because RUN is time-critical */
        return;
    }
    switch (sm->state) {
    case STATE_FAULT:
        step_fault(sm, axis, loop);
        break;
    case STATE_INIT:
        step_init(sm, axis, loop);
        break;
    default:
        step_stop(sm, axis, loop);
        break;
    }
}
