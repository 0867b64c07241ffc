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

/* Requests that do not outlive a fault: the drive never starts again by itself. */
static void go_to_fault(sm_t *sm)
{
    sm->ctrl = SM_CTRL_NONE;
    sm->state = STATE_FAULT;
}

static void step_fault(sm_t *sm, struct axis *axis)
{
    sm->states->fault(axis);
    (void)take(sm, SM_CTRL_FAULT);
    if (take(sm, SM_CTRL_FAULT_CLEAR)) {
        sm->transitions->fault_init(axis);
        sm->ctrl = SM_CTRL_NONE;
        sm->state = STATE_INIT;
    }
}

static void step_init(sm_t *sm, struct axis *axis)
{
    sm->states->init(axis);
    if (take(sm, SM_CTRL_FAULT)) {
        sm->transitions->init_fault(axis);
        go_to_fault(sm);
    } else if (take(sm, SM_CTRL_INIT_DONE)) {
        sm->transitions->init_stop(axis);
        sm->state = STATE_STOP;
    }
}

static void step_stop(sm_t *sm, struct axis *axis)
{
    sm->states->stop(axis);
    if (take(sm, SM_CTRL_FAULT)) {
        sm->transitions->stop_fault(axis);
        go_to_fault(sm);
    } else if ((sm->ctrl & SM_CTRL_START) != 0U) {
        sm->transitions->stop_run(axis);
        if (take(sm, SM_CTRL_RUN_ACK)) {
            (void)take(sm, SM_CTRL_START);
            sm->state = STATE_RUN;
        }
    }
}

static void step_run(sm_t *sm, struct axis *axis)
{
    sm->states->run(axis);
    if (take(sm, SM_CTRL_FAULT)) {
        sm->transitions->run_fault(axis);
        go_to_fault(sm);
    } else if ((sm->ctrl & SM_CTRL_STOP) != 0U) {
        sm->transitions->run_stop(axis);
        if (take(sm, SM_CTRL_STOP_ACK)) {
            (void)take(sm, SM_CTRL_STOP);
            sm->state = STATE_STOP;
        }
    }
}

void sm_step(sm_t *sm, struct axis *axis)
{
    switch (sm->state) {
    case STATE_FAULT:
        step_fault(sm, axis);
        break;
    case STATE_INIT:
        step_init(sm, axis);
        break;
    case STATE_STOP:
        step_stop(sm, axis);
        break;
    default:
        step_run(sm, axis);
        break;
    }
}
