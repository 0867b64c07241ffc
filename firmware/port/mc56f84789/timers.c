/* timers.c - four timers per encoder (DRM 2.4, F10): count, time stamp, turns, age of the last edge. */
#include "port/mc56f84789/drivers.h"

#define ARM_TRIES 3U

/* ---- counters --------------------------------------------------------------------------------------------------- */

uint16_t hal_encoder_count(hal_t *hal, uint16_t axis)
{
    return REG_READ(hal, timer_register(hal, axis, TIMER_COUNT, TMR_CNTR));
}

void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count)
{
    REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_CNTR), count);
}

uint16_t hal_index_count(hal_t *hal, uint16_t axis)
{
    return REG_READ(hal, timer_register(hal, axis, TIMER_INDEX, TMR_CNTR));
}

/* Read the counter before the flag: it may overflow between the two. */
uint32_t hal_edge_age(hal_t *hal, uint16_t axis)
{
    const uint16_t age = REG_READ(hal, timer_register(hal, axis, TIMER_AGE, TMR_CNTR));
    const bool overflow = (REG_READ(hal, timer_register(hal, axis, TIMER_AGE, TMR_SCTRL)) & TMR_SCTRL_TOF) != 0U;
    return overflow ? HAL_EDGE_AGE_OVERFLOW : age;
}

/* ---- captures (DRM F17): a set IEF keeps the capture, until it is cleared --------------------------------------- */

static bool captured(hal_t *hal, uint16_t axis, uint16_t channel)
{
    return (REG_READ(hal, timer_register(hal, axis, channel, TMR_SCTRL)) & TMR_SCTRL_IEF) != 0U;
}

/* Flags are cleared by writing 0; the overflow flag of the timer is kept, unless an edge has ended the overflow. */
static void age_open(hal_t *hal, uint16_t axis)
{
    const uint16_t sctrl = REG_READ(hal, timer_register(hal, axis, TIMER_AGE, TMR_SCTRL));
    const uint16_t overflow = ((sctrl & TMR_SCTRL_IEF) != 0U) ? 0U : (sctrl & TMR_SCTRL_TOF);
    REG_WRITE(hal, timer_register(hal, axis, TIMER_AGE, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE | overflow);
}

void hal_capture_arm(hal_t *hal, uint16_t axis)
{
    port_axis_t *state = &hal->axis[axis];
    for (uint16_t tries = 0; tries < ARM_TRIES; tries++) {
        age_open(hal, axis);
        REG_WRITE(hal, timer_register(hal, axis, TIMER_STAMP, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE);
        REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE | TMR_SCTRL_IEFIE);
        /* An edge between these writes is in only some of the captures: repeat. */
        const bool count = captured(hal, axis, TIMER_COUNT);
        if (count == captured(hal, axis, TIMER_STAMP)) {
            break;
        }
    }
    state->arms++;
    state->armed = true;
}

/* A loop may interrupt the edge handler here, take the capture and arm again: the capture then belongs to the loop. */
bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture)
{
    port_axis_t *state = &hal->axis[axis];
    const uint16_t arms = state->arms;
    if (!state->armed || !captured(hal, axis, TIMER_COUNT)) {
        return false;
    }
    state->armed = false;
    const uint16_t count = REG_READ(hal, timer_register(hal, axis, TIMER_COUNT, TMR_CAPT));
    const uint16_t time = REG_READ(hal, timer_register(hal, axis, TIMER_STAMP, TMR_CAPT));
    if (state->arms != arms) {
        return false;
    }
    /* IEF stays set and blocks later captures. */
    REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE | TMR_SCTRL_IEF);
    REG_WRITE(hal, timer_register(hal, axis, TIMER_AGE, TMR_SCTRL),
              SET_TMR_SCTRL_CAPTURE | TMR_SCTRL_IEF); /* the edge ends an overflow */
    capture->count = count;
    capture->time = time;
    return true;
}

/* ---- the edge interrupt ----------------------------------------------------------------------------------------- */

static void edge(hal_t *hal, uint16_t axis)
{
    servo_edge_isr(hal->servo, axis);
    /* An edge that was not taken must not cause the interrupt again and again. */
    const uint16_t waiting = TMR_SCTRL_IEF | TMR_SCTRL_IEFIE;
    if ((REG_READ(hal, timer_register(hal, axis, TIMER_COUNT, TMR_SCTRL)) & waiting) == waiting) {
        REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE | TMR_SCTRL_IEF);
    }
}

void port_edge_1(hal_t *hal) { edge(hal, 0U); }

void port_edge_2(hal_t *hal) { edge(hal, 1U); }
