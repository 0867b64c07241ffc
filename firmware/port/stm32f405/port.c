/* port.c - the cycle of the two fast loops (DRM 4.3). */
#include "port/stm32f405/port.h"

#include "port/stm32f405/drivers.h"

/* The loss counter decays by one per period: more than four losses in 16 ms are too many. */
#define LOSS 64U
#define LOSSES_MAX 256U

#define LOOPS 2U /* M1 and M2 */

/* Out of an exception, too, when `hal` may not be set yet. */
void outputs_off(hal_t *hal)
{
    REG_WRITE(hal, TIM1_BASE + TIM_BDTR, SET_PWM_BDTR_OFF);
    REG_WRITE(hal, TIM8_BASE + TIM_BDTR, SET_PWM_BDTR_OFF);
    brake_open(hal);
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        hal_holding_brake(hal, axis, false);
    }
}

/* After a lost result the duty cycles stay constant for one period while the converters start again. After repeated
 * losses all outputs are off, and the watchdog, which only running loops serve, resets the board. */
static void sequence_lost(hal_t *hal)
{
    hal->losses = (uint16_t)(hal->losses + LOSS);
    if (hal->losses <= LOSSES_MAX) {
        adc_arm(hal);
        return;
    }
    outputs_off(hal);
}

/* Pairs of loops omitted since the last M1. The application detects a single omitted loop. */
static void note_gap(hal_t *hal)
{
    const uint32_t now = clocks(hal);
    const uint32_t gap = now - hal->last;
    hal->last = now;
    if (gap >= GAP_CLOCKS && hal->running) {
        const uint32_t periods = (gap + PWM_PERIOD / 2U) / PWM_PERIOD;
        const uint32_t paired = (hal->m2_runs > 1U) ? hal->m2_runs : 1U; /* periods with an M2 */
        hal->late = (uint16_t)(hal->late + ((periods > paired) ? LOOPS * (periods - paired) : 0U));
    }
    hal->m2_runs = 0;
    hal->running = true;
}

uint16_t hal_late_loops(hal_t *hal) { return hal->late; }

void hal_duties_done(hal_t *hal, uint16_t axis)
{
    if (hal->axis[axis].behind) {
        hal->late++;
    }
}

/* What both loops begin with. The limit of the current comes first. */
static void begin(hal_t *hal, uint16_t axis)
{
    port_axis_t *state = &hal->axis[axis];
    if (over_current(hal, axis) && !state->tripped) {
        switches_open(hal, axis);
        state->tripped = true;
        servo_over_current_isr(hal->servo, axis);
    }
    state->behind = false;
    encoder_follow(hal, axis); /* also of an axis that does not use its encoder now */
}

void port_m1(hal_t *hal)
{
    if (!adc_take_m1(hal)) {
        sequence_lost(hal);
        return;
    }
    note_gap(hal);
    begin(hal, M1);
    servo_m1_isr(hal->servo);
}

void port_m2(hal_t *hal)
{
    if (!adc_take_m2(hal)) {
        sequence_lost(hal);
        return;
    }
    hal->m2_runs++;
    hal->losses = (uint16_t)(hal->losses - ((hal->losses > 0U) ? 1U : 0U));
    begin(hal, M2);
    servo_m2_isr(hal->servo);
}

void port_background(hal_t *hal)
{
    gate_service(hal);
    servo_background(hal->servo);
    serial_service(hal);
}
