/* sim.c - clock gates, pin functions, ports. */
#include "port/mc56f84789/drivers.h"

void sim_init(hal_t *hal)
{
    REG_WRITE(hal, SIM_PCE0, SET_SIM_PCE0);
    REG_WRITE(hal, SIM_PCE1, SET_SIM_PCE1);
    REG_WRITE(hal, SIM_PCE2, SET_SIM_PCE2);
    REG_WRITE(hal, SIM_PCE3, SET_SIM_PCE3);
    REG_WRITE(hal, SIM_PCR, SET_SIM_PCR);
    REG_WRITE(hal, SIM_IPS0, SET_SIM_IPS0);
}

static void pull_up(hal_t *hal, uint16_t port, uint16_t pins)
{
    REG_WRITE(hal, port + GPIO_PUS, pins);
    REG_WRITE(hal, port + GPIO_PUR, pins);
}

void hal_brake_resistor(hal_t *hal, bool on) { REG_WRITE(hal, GPIO(GPIO_G) + GPIO_DR, on ? PIN_BRAKE_RESISTOR : 0U); }

void hal_holding_brake(hal_t *hal, uint16_t axis, bool release)
{
    const uint16_t others = REG_READ(hal, GPIO(GPIO_D) + GPIO_DR) & (uint16_t)~PIN_HOLDING(axis);
    REG_WRITE(hal, GPIO(GPIO_D) + GPIO_DR, release ? others | PIN_HOLDING(axis) : others);
}

/* An open contact reads high: a home switch is closed within its range, a limit switch opens at the end of travel. */
uint16_t hal_inputs(hal_t *hal, uint16_t axis)
{
    const unsigned int raw = REG_READ(hal, GPIO(GPIO_F) + GPIO_RAWDATA);
    const uint16_t levels = raw >> SWITCHES_SHIFT(axis) & SWITCHES_MASK;
    const uint16_t fsts = REG_READ(hal, hal->axis[axis].pwm + PWM_FSTS0);
    const bool open = (fsts & (PWM_FSTS_FFLAG(ENABLE_INPUT) | PWM_FSTS_FFPIN(ENABLE_INPUT))) != 0U;
    return (uint16_t)((levels ^ HAL_INPUT_HOME) | (open ? 0U : HAL_INPUT_ENABLE));
}

/* Select the function of a pin first, then connect it to the peripheral. */
void pins_init(hal_t *hal)
{
    REG_WRITE(hal, SIM_GPSAL, SET_GPSAL);
    REG_WRITE(hal, SIM_GPSCL, SET_GPSCL);
    REG_WRITE(hal, SIM_GPSCH, SET_GPSCH);
    REG_WRITE(hal, SIM_GPSEL, SET_GPSEL);
    REG_WRITE(hal, SIM_GPSEH, SET_GPSEH);
    REG_WRITE(hal, SIM_GPSFL, SET_GPSFL);
    REG_WRITE(hal, SIM_GPSFH, SET_GPSFH);
    REG_WRITE(hal, SIM_GPSGL, SET_GPSGL);

    pull_up(hal, GPIO(GPIO_C), SET_GPIOC_PULL);
    pull_up(hal, GPIO(GPIO_E), SET_GPIOE_PULL);
    pull_up(hal, GPIO(GPIO_F), SET_GPIOF_PULL);

    REG_WRITE(hal, GPIO(GPIO_F) + GPIO_DR, 0U);
    REG_WRITE(hal, GPIO(GPIO_F) + GPIO_PPMODE, SET_GPIOF_DDR);
    REG_WRITE(hal, GPIO(GPIO_F) + GPIO_DDR, SET_GPIOF_DDR);

    REG_WRITE(hal, GPIO(GPIO_D) + GPIO_DR, 0U);
    REG_WRITE(hal, GPIO(GPIO_D) + GPIO_PPMODE, SET_GPIOD_DDR);
    REG_WRITE(hal, GPIO(GPIO_D) + GPIO_DDR, SET_GPIOD_DDR);

    hal_brake_resistor(hal, false);
    REG_WRITE(hal, GPIO(GPIO_G) + GPIO_PPMODE, SET_GPIOG_DDR);
    REG_WRITE(hal, GPIO(GPIO_G) + GPIO_DDR, SET_GPIOG_DDR);

    REG_WRITE(hal, GPIO(GPIO_A) + GPIO_PER, SET_GPIOA_PER);
    REG_WRITE(hal, GPIO(GPIO_B) + GPIO_PER, SET_GPIOB_PER);
    REG_WRITE(hal, GPIO(GPIO_C) + GPIO_PER, SET_GPIOC_PER);
    REG_WRITE(hal, GPIO(GPIO_E) + GPIO_PER, SET_GPIOE_PER);
    REG_WRITE(hal, GPIO(GPIO_F) + GPIO_PER, SET_GPIOF_PER);
    REG_WRITE(hal, GPIO(GPIO_G) + GPIO_PER, SET_GPIOG_PER);
}
