/* timers.c - four timers per encoder (DRM 2.4, F10): count, time stamp, turns, age of the last edge. */
#include "port/mc56f84789/drivers.h"

#define COUNT 0U /* quadrature counter, 0..3999 and 0..-3999 */
#define STAMP 1U /* free running */
#define INDEX 2U /* emulated index pulses */
#define AGE 3U   /* restarts at each capture */

#define ARM_TRIES 3U

static uint16_t at(const hal_t *hal, uint16_t axis, uint16_t channel, uint16_t reg)
{
    return (uint16_t)(hal->axis[axis].tmr + TMR_CHANNEL(channel) + reg);
}

static void module_init(hal_t *hal, uint16_t axis)
{
    REG_WRITE(hal, at(hal, axis, 0U, TMR_ENBL), 0U);
    for (uint16_t channel = 0; channel < TMR_CHANNELS; channel++) {
        REG_WRITE(hal, at(hal, axis, channel, TMR_CTRL), 0U);
        REG_WRITE(hal, at(hal, axis, channel, TMR_LOAD), 0U);
        REG_WRITE(hal, at(hal, axis, channel, TMR_CNTR), 0U);
        REG_WRITE(hal, at(hal, axis, channel, TMR_CSCTRL), 0U);
        REG_WRITE(hal, at(hal, axis, channel, TMR_SCTRL), 0U);
        REG_WRITE(hal, at(hal, axis, channel, TMR_FILT), 0U);
    }
    /* The filter of a channel is that of the input with its number, for all channels. */
    REG_WRITE(hal, at(hal, axis, INPUT_A, TMR_FILT), SET_TMR_FILT);
    REG_WRITE(hal, at(hal, axis, INPUT_B, TMR_FILT), SET_TMR_FILT);

    REG_WRITE(hal, at(hal, axis, COUNT, TMR_COMP1), SET_TMR0_COMP1);
    REG_WRITE(hal, at(hal, axis, COUNT, TMR_COMP2), SET_TMR0_COMP2);
    REG_WRITE(hal, at(hal, axis, COUNT, TMR_LOAD), SET_TMR0_LOAD);
    REG_WRITE(hal, at(hal, axis, AGE, TMR_CSCTRL), SET_TMR3_CSCTRL);
    REG_WRITE(hal, at(hal, axis, COUNT, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE);
    REG_WRITE(hal, at(hal, axis, STAMP, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE);
    REG_WRITE(hal, at(hal, axis, AGE, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE);

    REG_WRITE(hal, at(hal, axis, COUNT, TMR_CTRL), SET_TMR0_CTRL);
    REG_WRITE(hal, at(hal, axis, STAMP, TMR_CTRL), SET_TMR_CTRL_TIME);
    REG_WRITE(hal, at(hal, axis, INDEX, TMR_CTRL), SET_TMR2_CTRL);
    REG_WRITE(hal, at(hal, axis, AGE, TMR_CTRL), SET_TMR_CTRL_TIME);
    REG_WRITE(hal, at(hal, axis, 0U, TMR_ENBL), TMR_ENBL_MASK);
}

void timers_init(hal_t *hal)
{
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        module_init(hal, axis);
        hal->axis[axis].armed = false;
        hal->axis[axis].arms = 0;
    }
}

/* ---- counters --------------------------------------------------------------------------------------------------- */

uint16_t hal_encoder_count(hal_t *hal, uint16_t axis) { return REG_READ(hal, at(hal, axis, COUNT, TMR_CNTR)); }

void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count)
{
    REG_WRITE(hal, at(hal, axis, COUNT, TMR_CNTR), count);
}

uint16_t hal_index_count(hal_t *hal, uint16_t axis) { return REG_READ(hal, at(hal, axis, INDEX, TMR_CNTR)); }

/* Counter before flag: it may run over between the two. */
uint32_t hal_edge_age(hal_t *hal, uint16_t axis)
{
    const uint16_t age = REG_READ(hal, at(hal, axis, AGE, TMR_CNTR));
    const bool overflow = (REG_READ(hal, at(hal, axis, AGE, TMR_SCTRL)) & TMR_SCTRL_TOF) != 0U;
    return overflow ? HAL_EDGE_AGE_OVERFLOW : age;
}

/* ---- captures (DRM F17): a set IEF keeps the capture, until it is cleared --------------------------------------- */

static bool latched(hal_t *hal, uint16_t axis, uint16_t channel)
{
    return (REG_READ(hal, at(hal, axis, channel, TMR_SCTRL)) & TMR_SCTRL_IEF) != 0U;
}

/* Flags are cleared by writing 0; the timer's overflow survives, unless an edge has ended it. */
static void age_open(hal_t *hal, uint16_t axis)
{
    const uint16_t sctrl = REG_READ(hal, at(hal, axis, AGE, TMR_SCTRL));
    const uint16_t overflow = ((sctrl & TMR_SCTRL_IEF) != 0U) ? 0U : (sctrl & TMR_SCTRL_TOF);
    REG_WRITE(hal, at(hal, axis, AGE, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE | overflow);
}

void hal_capture_arm(hal_t *hal, uint16_t axis)
{
    port_axis_t *state = &hal->axis[axis];
    for (uint16_t tries = 0; tries < ARM_TRIES; tries++) {
        age_open(hal, axis);
        REG_WRITE(hal, at(hal, axis, STAMP, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE);
        REG_WRITE(hal, at(hal, axis, COUNT, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE | TMR_SCTRL_IEFIE);
        /* An edge between these writes is in some of the captures and not in the others: once more. */
        const bool count = latched(hal, axis, COUNT);
        if (count == latched(hal, axis, STAMP)) {
            break;
        }
    }
    state->arms++;
    state->armed = true;
}

/* The loops may interrupt the edge handler right here, take the edge and arm anew: then it is theirs. */
bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture)
{
    port_axis_t *state = &hal->axis[axis];
    const uint16_t arms = state->arms;
    if (!state->armed || !latched(hal, axis, COUNT)) {
        return false;
    }
    state->armed = false;
    const uint16_t count = REG_READ(hal, at(hal, axis, COUNT, TMR_CAPT));
    const uint16_t time = REG_READ(hal, at(hal, axis, STAMP, TMR_CAPT));
    if (state->arms != arms) {
        return false;
    }
    /* IEF stays set and keeps later edges out. */
    REG_WRITE(hal, at(hal, axis, COUNT, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE | TMR_SCTRL_IEF);
    REG_WRITE(hal, at(hal, axis, AGE, TMR_SCTRL),
              SET_TMR_SCTRL_CAPTURE | TMR_SCTRL_IEF); /* the edge ends an overflow */
    capture->count = count;
    capture->time = time;
    return true;
}

/* ---- the edge interrupt ----------------------------------------------------------------------------------------- */

static void edge(hal_t *hal, uint16_t axis)
{
    servo_edge_isr(hal->servo, axis);
    /* Who did not take the edge must not be asked again and again. */
    const uint16_t waiting = TMR_SCTRL_IEF | TMR_SCTRL_IEFIE;
    if ((REG_READ(hal, at(hal, axis, COUNT, TMR_SCTRL)) & waiting) == waiting) {
        REG_WRITE(hal, at(hal, axis, COUNT, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE | TMR_SCTRL_IEF);
    }
}

void port_edge_1(hal_t *hal) { edge(hal, 0U); }

void port_edge_2(hal_t *hal) { edge(hal, 1U); }
