/* brake.c - TIM2: half bridge of the brake resistor, monitor outputs. Its registers have no preload. */
#include "port/stm32f405/drivers.h"

static void write(hal_t *hal, uint32_t reg, uint32_t value) { REG_WRITE(hal, TIM2_BASE + reg, value); }

void brake_init(hal_t *hal)
{
    write(hal, TIM_CR1, 0U);
    write(hal, TIM_PSC, 0U);
    write(hal, TIM_ARR, BRAKE_PERIOD);
    write(hal, TIM_CCMR1, SET_TIM2_CCMR1);
    write(hal, TIM_CCMR2, SET_TIM2_CCMR2);
    write(hal, TIM_CCR1, BRAKE_PERIOD / 2U);
    write(hal, TIM_CCR2, BRAKE_PERIOD / 2U);
    write(hal, TIM_CCR3, BRAKE_ALWAYS_LOW);
    write(hal, TIM_CCR4, BRAKE_NEVER_HIGH);
    write(hal, TIM_CNT, 0U);
    write(hal, TIM_CCER, SET_TIM2_CCER);
    write(hal, TIM_CR1, SET_TIM2_CR1);
    hal->braking = false;
}

void brake_open(hal_t *hal)
{
    write(hal, TIM_CCR4, BRAKE_NEVER_HIGH);
    write(hal, TIM_CCR3, 0U);
}

/* Both switches open for the dead time; then the one that may conduct now. While the resistor is on, the bootstrap
 * capacitor is charged in the rest of each period: the mean voltage is that of 95 % of the bus. A debugger that holds
 * the core would leave it on: the watchdog goes on then. */
void hal_brake_resistor(hal_t *hal, bool on)
{
    if (on == hal->braking) {
        return;
    }
    hal->braking = on;
    brake_open(hal);
    debug_freeze(hal, !on);
    wait_clocks(hal, CLOCKS_OF_NS(BRAKE_DEAD_NS));
    if (on) {
        write(hal, TIM_CCR4, BRAKE_HIGH_FROM);
        write(hal, TIM_CCR3, BRAKE_LOW_BELOW);
    } else {
        write(hal, TIM_CCR3, BRAKE_ALWAYS_LOW);
    }
}

void hal_analog_out(hal_t *hal, uint16_t channel, uint16_t value)
{
    write(hal, (channel == 0U) ? TIM_CCR1 : TIM_CCR2, ((uint32_t)value * BRAKE_PERIOD) >> 16);
}
