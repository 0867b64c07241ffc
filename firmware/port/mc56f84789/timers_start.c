/* timers_start.c - the four timers of each encoder set up. */
#include "port/mc56f84789/drivers.h"

static void module_init(hal_t *hal, uint16_t axis)
{
    REG_WRITE(hal, timer_register(hal, axis, 0U, TMR_ENBL), 0U);
    for (uint16_t channel = 0; channel < TMR_CHANNELS; channel++) {
        REG_WRITE(hal, timer_register(hal, axis, channel, TMR_CTRL), 0U);
        REG_WRITE(hal, timer_register(hal, axis, channel, TMR_LOAD), 0U);
        REG_WRITE(hal, timer_register(hal, axis, channel, TMR_CNTR), 0U);
        REG_WRITE(hal, timer_register(hal, axis, channel, TMR_CSCTRL), 0U);
        REG_WRITE(hal, timer_register(hal, axis, channel, TMR_SCTRL), 0U);
        REG_WRITE(hal, timer_register(hal, axis, channel, TMR_FILT), 0U);
    }
    /* The filter register of channel n belongs to input n, for all channels that use that input. */
    REG_WRITE(hal, timer_register(hal, axis, INPUT_A, TMR_FILT), SET_TMR_FILT);
    REG_WRITE(hal, timer_register(hal, axis, INPUT_B, TMR_FILT), SET_TMR_FILT);

    REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_LOAD), SET_TMR0_LOAD);
    REG_WRITE(hal, timer_register(hal, axis, TIMER_AGE, TMR_CSCTRL), SET_TMR3_CSCTRL);
    REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE);
    REG_WRITE(hal, timer_register(hal, axis, TIMER_STAMP, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE);
    REG_WRITE(hal, timer_register(hal, axis, TIMER_AGE, TMR_SCTRL), SET_TMR_SCTRL_CAPTURE);

    REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_CTRL), SET_TMR0_CTRL);
    REG_WRITE(hal, timer_register(hal, axis, TIMER_STAMP, TMR_CTRL), SET_TMR_CTRL_TIME);
    REG_WRITE(hal, timer_register(hal, axis, TIMER_INDEX, TMR_CTRL), SET_TMR2_CTRL);
    REG_WRITE(hal, timer_register(hal, axis, TIMER_AGE, TMR_CTRL), SET_TMR_CTRL_TIME);
    REG_WRITE(hal, timer_register(hal, axis, 0U, TMR_ENBL), TMR_ENBL_MASK);
}

void timers_init(hal_t *hal)
{
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        module_init(hal, axis);
        hal->axis[axis].armed = false;
        hal->axis[axis].arms = 0;
    }
}

void hal_encoder_start(hal_t *hal, uint16_t axis, uint16_t period)
{
    REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_COMP1), (uint16_t)(period - 1U));
    REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_COMP2), (uint16_t)(1U - (uint32_t)period));
    REG_WRITE(hal, timer_register(hal, axis, TIMER_COUNT, TMR_CNTR), 0U);
}
