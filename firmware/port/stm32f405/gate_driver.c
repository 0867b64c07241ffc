/* gate_driver.c - two DRV8301 on SPI3, with one line for enabling both and one for the faults of both. */
#include "port/stm32f405/drivers.h"
#include "port/stm32f405/port.h"

#define SPI(reg) (SPI3_BASE + (reg))

/* ---- frames of 16 bits; the answer to a read comes in the next one -------------------------------------------------- */

static uint32_t frame(hal_t *hal, uint16_t driver, uint32_t word)
{
    set_pin(hal, PORT_C, PIN_SELECT(driver), false);
    REG_WRITE(hal, SPI(SPI_DR), word);
    (void)wait_for(hal, SPI(SPI_SR), SPI_SR_RXNE, SPI_SR_RXNE);
    const uint32_t answer = REG_READ(hal, SPI(SPI_DR));
    (void)wait_for(hal, SPI(SPI_SR), SPI_SR_BSY, 0U);
    set_pin(hal, PORT_C, PIN_SELECT(driver), true);
    wait_clocks(hal, CLOCKS_OF_NS(SPI_PAUSE_NS));
    return answer;
}

static uint16_t read(hal_t *hal, uint16_t driver, uint32_t address)
{
    (void)frame(hal, driver, DRV_READ(address));
    return (uint16_t)(frame(hal, driver, DRV_READ(address)) & DRV_DATA);
}

/* Reading the status clears it. */
static bool reports_none(hal_t *hal, uint16_t driver)
{
    const uint16_t status = read(hal, driver, DRV_STATUS_1);
    if (status != 0U) {
        hal->gate_status[driver] = status;
    }
    return status == 0U;
}

static bool as_set(hal_t *hal, uint16_t driver)
{
    return read(hal, driver, DRV_CONTROL_1) == SET_DRV_CONTROL_1 &&
           read(hal, driver, DRV_CONTROL_2) == SET_DRV_CONTROL_2 && reports_none(hal, driver) &&
           (read(hal, driver, DRV_STATUS_2) & DRV_STATUS_2_GVDD_OV) == 0U;
}

/* ---- start ------------------------------------------------------------------------------------------------------ */

/* Clear the latches and set both drivers up; true if both say so and report no fault. */
static bool set_up(hal_t *hal)
{
    for (uint16_t driver = 0; driver < HAL_AXES; driver++) {
        (void)reports_none(hal, driver);
        (void)frame(hal, driver, DRV_WRITE(DRV_CONTROL_1, SET_DRV_CONTROL_1 | DRV_CONTROL_1_GATE_RESET));
        for (uint16_t i = 0; i < DRV_WRITES; i++) {
            (void)frame(hal, driver, DRV_WRITE(DRV_CONTROL_1, SET_DRV_CONTROL_1));
        }
        (void)frame(hal, driver, DRV_WRITE(DRV_CONTROL_2, SET_DRV_CONTROL_2));
    }
    wait_clocks(hal, CLOCKS_OF_US(GATE_SETTLE_US));
    bool fine = true;
    for (uint16_t driver = 0; driver < HAL_AXES; driver++) {
        fine = as_set(hal, driver) && fine;
    }
    return fine && pin_is_high(hal, PORT_D, PIN_FAULT);
}

/* The registers of the drivers are lost; the supply of the gates of both motors and of the brake half bridge is off
 * until GATE_START_US have passed. */
static void enable_again(hal_t *hal)
{
    set_pin(hal, PORT_B, PIN_EN_GATE, false);
    wait_clocks(hal, CLOCKS_OF_US(GATE_OFF_US));
    set_pin(hal, PORT_B, PIN_EN_GATE, true);
    hal->gate_checked = clocks(hal);
}

/* A fault that the drivers report meanwhile ends the attempt. */
static void try_start(hal_t *hal)
{
    hal->gate = GATE_STARTING;
    if (!set_up(hal)) {
        hal->gate = GATE_FAILED;
        enable_again(hal);
        return;
    }
    hal->gate_checked = clocks(hal);
    const uint32_t before = INTERRUPTS_OFF(hal);
    if (hal->gate == GATE_STARTING) {
        hal->gate = GATE_READY;
    }
    INTERRUPTS_RESTORE(hal, before);
}

/* Without a supply of the bus the drivers do not start: the background tries again, and the over-current of both axes
 * is active meanwhile. */
void gate_start(hal_t *hal)
{
    REG_WRITE(hal, SPI(SPI_CR1), SET_SPI_CR1);
    hal->gate = GATE_FAILED;
    enable_again(hal);
    wait_clocks(hal, CLOCKS_OF_US(GATE_START_US));
    try_start(hal);
    REG_WRITE(hal, EXTI_BASE + EXTI_PR, EXTI_PR_PR(PIN_FAULT)); /* edges of the start */
}

/* ---- faults ----------------------------------------------------------------------------------------------------- */

/* The line does not say which driver: both inverters are switched off. */
void port_gate_fault(hal_t *hal)
{
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        switches_open(hal, axis);
        hal->axis[axis].tripped = true;
    }
    hal->gate = GATE_FAILED;
    REG_WRITE(hal, EXTI_BASE + EXTI_PR, EXTI_PR_PR(PIN_FAULT));
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        servo_over_current_isr(hal->servo, axis);
    }
}

static void report(hal_t *hal) { REG_WRITE(hal, EXTI_BASE + EXTI_SWIER, EXTI_SWIER_SWIER(PIN_FAULT)); }

/* A short fault may leave no edge, and a loss of supply resets the gains: look at the line always, at the registers
 * from time to time. A fault is cleared in the drivers here, and stays in the port until the application clears it. */
void gate_service(hal_t *hal)
{
    const uint32_t since = clocks(hal) - hal->gate_checked;
    if (hal->gate == GATE_FAILED) {
        if (since >= CLOCKS_OF_US(GATE_START_US)) {
            try_start(hal);
        }
        return;
    }
    if (!pin_is_high(hal, PORT_D, PIN_FAULT)) {
        report(hal);
    } else if (since >= CLOCKS_OF_US(GATE_CHECK_US)) {
        hal->gate_checked = clocks(hal);
        if (!as_set(hal, M1) || !as_set(hal, M2)) {
            report(hal);
        }
    }
}

bool hal_over_current_active(hal_t *hal, uint16_t axis) { return hal->axis[axis].tripped || hal->gate != GATE_READY; }

/* The limit in software trips again at the next sample, the drivers' by their line: not between test and clearing. */
void hal_over_current_clear(hal_t *hal, uint16_t axis)
{
    const uint32_t before = INTERRUPTS_OFF(hal);
    if (hal->gate == GATE_READY && pin_is_high(hal, PORT_D, PIN_FAULT)) {
        hal->axis[axis].tripped = false;
    }
    INTERRUPTS_RESTORE(hal, before);
}
