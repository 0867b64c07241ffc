/* encoder.c - counts, emulated index pulses, and the time of an armed edge of channel B. The timers count freely with 16
 * bits; position in the turn and turns are derived from their differences. */
#include "port/stm32f405/drivers.h"
#include "port/stm32f405/port.h"

#define PERIOD_AT_RESET 4000U

void encoders_init(hal_t *hal)
{
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        const uint32_t base = hal->axis[i].encoder;
        REG_WRITE(hal, base + TIM_CR1, 0U);
        REG_WRITE(hal, base + TIM_SMCR, SET_ENCODER_SMCR);
        REG_WRITE(hal, base + TIM_CCMR1, SET_ENCODER_CCMR1);
        REG_WRITE(hal, base + TIM_CCER, 0U); /* neither channel is inverted */
        REG_WRITE(hal, base + TIM_PSC, 0U);
        REG_WRITE(hal, base + TIM_ARR, ENCODER_TOP);
        REG_WRITE(hal, base + TIM_CNT, 0U);
        REG_WRITE(hal, base + TIM_CR1, TIM_CR1_CEN);
        hal_encoder_start(hal, i, PERIOD_AT_RESET);
    }
}

static void mask_edge(hal_t *hal, uint16_t axis, bool on)
{
    const uint32_t line = EXTI_IMR_MR(PIN_B(axis));
    const uint32_t others = REG_READ(hal, EXTI_BASE + EXTI_IMR) & ~line;
    REG_WRITE(hal, EXTI_BASE + EXTI_IMR, on ? others | line : others);
}

/* port_stamp may interrupt the change of the mask, and the line of the other axis stay open: a second edge is ignored
 * there. */
static void open_line(hal_t *hal, uint16_t axis)
{
    hal->axis[axis].uncounted = false;
    REG_WRITE(hal, EXTI_BASE + EXTI_PR, EXTI_PR_PR(PIN_B(axis)));
    hal->axis[axis].armed = true;
    mask_edge(hal, axis, true);
}

/* ---- counts ----------------------------------------------------------------------------------------------------- */

/* A count in the turn after a difference: it begins anew at 0 behind the last count in either direction. */
static int32_t wrapped(int32_t count, int32_t period)
{
    return (count >= period) ? count - period : (count <= -period) ? count + period : count;
}

void encoder_follow(hal_t *hal, uint16_t axis)
{
    port_axis_t *state = &hal->axis[axis];
    const uint16_t raw = (uint16_t)REG_READ(hal, state->encoder + TIM_CNT);
    const int32_t moved = (int32_t)(int16_t)state->count + (int16_t)(uint16_t)(raw - state->raw);
    const int32_t count = wrapped(moved, state->period);
    if (count != moved) {
        state->index++;
    }
    state->raw = raw;
    state->count = (uint16_t)count;
    if (state->uncounted) { /* not before the next loop: pulses take no more time than these interrupts */
        open_line(hal, axis);
    }
}

void hal_encoder_start(hal_t *hal, uint16_t axis, uint16_t period)
{
    hal->axis[axis].period = period;
    hal_encoder_preset(hal, axis, 0U);
}

uint16_t hal_encoder_count(hal_t *hal, uint16_t axis)
{
    encoder_follow(hal, axis);
    return hal->axis[axis].count;
}

void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count)
{
    hal->axis[axis].raw = (uint16_t)REG_READ(hal, hal->axis[axis].encoder + TIM_CNT);
    hal->axis[axis].count = count;
}

uint16_t hal_index_count(hal_t *hal, uint16_t axis) { return hal->axis[axis].index; }

/* ---- edges: an interrupt above the loops takes count and time, one below them does the rest ------------------------ */

void hal_capture_arm(hal_t *hal, uint16_t axis)
{
    port_axis_t *state = &hal->axis[axis];
    (void)hal_edge_age(hal, axis);
    state->armed = false;
    state->captured = false;
    state->armed_raw = (uint16_t)REG_READ(hal, state->encoder + TIM_CNT);
    open_line(hal, axis);
}

/* The timer filters its inputs, the line does not: a pulse that is too short to be counted is no edge. Behind a true
 * one the count is never that of the arming: counts beside it are reached by either channel A or channel B. */
void port_stamp(hal_t *hal)
{
    const uint32_t now = clocks(hal);
    const uint32_t pending = REG_READ(hal, EXTI_BASE + EXTI_PR);
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        port_axis_t *state = &hal->axis[axis];
        if ((pending & EXTI_PR_PR(PIN_B(axis))) == 0U) {
            continue;
        }
        mask_edge(hal, axis, false);
        REG_WRITE(hal, EXTI_BASE + EXTI_PR, EXTI_PR_PR(PIN_B(axis)));
        if (state->armed && !state->captured) {
            const uint16_t raw = (uint16_t)REG_READ(hal, state->encoder + TIM_CNT);
            if (raw == state->armed_raw) {
                state->uncounted = true;
                continue;
            }
            state->edge_raw = raw;
            state->edge_at = now;
            state->edges++;
            state->captured = true;
            REG_WRITE(hal, EXTI_BASE + EXTI_SWIER, EXTI_SWIER_SWIER(LINE_EDGE(axis)));
        }
    }
}

void port_edge(hal_t *hal)
{
    const uint32_t pending = REG_READ(hal, EXTI_BASE + EXTI_PR);
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        if ((pending & EXTI_PR_PR(LINE_EDGE(axis))) != 0U) {
            REG_WRITE(hal, EXTI_BASE + EXTI_PR, EXTI_PR_PR(LINE_EDGE(axis)));
            servo_edge_isr(hal->servo, axis);
        }
    }
}

/* Count of the encoder at the edge, from a pair of counts that belong together. */
static uint16_t count_at_edge(const port_axis_t *state)
{
    const int32_t moved = (int32_t)(int16_t)state->count + (int16_t)(uint16_t)(state->edge_raw - state->raw);
    return (uint16_t)wrapped(moved, state->period);
}

/* The edge handler, and a loop that may interrupt it, take captures: each edge belongs to one of them. */
bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture)
{
    port_axis_t *state = &hal->axis[axis];
    const uint32_t before = INTERRUPTS_OFF(hal);
    const bool taken = state->armed && state->captured;
    if (taken) {
        capture->count = count_at_edge(state);
        capture->time = (uint16_t)(state->edge_at >> STAMP_SHIFT);
        state->armed = false;
    }
    INTERRUPTS_RESTORE(hal, before);
    return taken;
}

/* The count of clocks begins anew every 25 s: an age that was too long once stays so until the next edge. The clock is
 * read behind the time of the edge, which port_stamp may change: no age is negative. */
uint32_t hal_edge_age(hal_t *hal, uint16_t axis)
{
    port_axis_t *state = &hal->axis[axis];
    uint16_t edges;
    uint32_t at;
    do {
        edges = state->edges;
        at = state->edge_at;
    } while (edges != state->edges);
    const uint32_t age = (clocks(hal) - at) >> STAMP_SHIFT;
    if (age >= HAL_EDGE_AGE_OVERFLOW) {
        state->edges_old = edges;
    }
    return (state->edges_old == edges) ? HAL_EDGE_AGE_OVERFLOW : age;
}
