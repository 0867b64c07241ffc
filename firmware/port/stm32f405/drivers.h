/* drivers.h - what the files of this port know of each other. */
#ifndef STM32F405_DRIVERS_H
#define STM32F405_DRIVERS_H

#include "port/stm32f405/access.h"
#include "port/stm32f405/hal_data.h"
#include "port/stm32f405/registers.h"
#include "port/stm32f405/settings.h"

#define M1 0U
#define M2 1U

/* Read until the bits under `mask` are `value`; false if they never are. */
bool wait_for(hal_t *hal, uint32_t address, uint32_t mask, uint32_t value);

/* Free-running count of core clocks, in steps of TIM5_CLOCKS. Whether the cycle counter of the core goes on while it
 * sleeps depends on the chip: a timer does. */
static inline uint32_t clocks(hal_t *hal) { return TIM5_CLOCKS * REG_READ(hal, TIM5_BASE + TIM_CNT); }

/* Core clocks that pass, at least. */
void wait_clocks(hal_t *hal, uint32_t duration);

bool clock_init(hal_t *hal);
void debug_freeze(hal_t *hal, bool watchdog); /* what stops with the core in a debugger */
void watchdog_start(hal_t *hal);
void pins_init(hal_t *hal);
void interrupts_init(hal_t *hal);

static inline bool pin_is_high(hal_t *hal, uint32_t port, uint32_t pin)
{
    return (REG_READ(hal, port + GPIO_IDR) & GPIO_IDR_IDR(pin)) != 0U;
}

static inline void set_pin(hal_t *hal, uint32_t port, uint32_t pin, bool high)
{
    REG_WRITE(hal, port + GPIO_BSRR, high ? GPIO_BSRR_BS(pin) : GPIO_BSRR_BR(pin));
}

void pwm_init(hal_t *hal);
bool pwm_run(hal_t *hal);
void switches_open(hal_t *hal, uint16_t axis); /* at once, from any interrupt */

void brake_init(hal_t *hal);
void brake_open(hal_t *hal); /* both switches of the half bridge */

void outputs_off(hal_t *hal); /* all switches open, holding brakes without current, in any state of the port */

void adc_init(hal_t *hal);
void adc_arm(hal_t *hal);
bool adc_take_m1(hal_t *hal); /* results of t0; false if they are not complete */
bool adc_take_m2(hal_t *hal); /* results of t2 */
bool over_current(const hal_t *hal, uint16_t axis);

void encoders_init(hal_t *hal);
void encoder_follow(hal_t *hal, uint16_t axis);

void gate_start(hal_t *hal);   /* waits: before the interrupts */
void gate_service(hal_t *hal); /* in the background */

void serial_init(hal_t *hal);
void serial_service(hal_t *hal); /* in the background */

#endif
