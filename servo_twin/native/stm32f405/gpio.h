/* gpio.h - ports A to D: modes, functions, levels; external interrupts (EXTI) and their selection (SYSCFG). */
#ifndef STM32F405_GPIO_H
#define STM32F405_GPIO_H

#include "stm32f405/soc.h"

typedef enum { GPIO_INPUT, GPIO_OUTPUT, GPIO_FUNCTION, GPIO_ANALOG } gpio_mode_t;

typedef struct {
    uint32_t moder, otyper, ospeedr, pupdr, odr, afr[2];
    uint32_t outside, driven; /* levels from outside, and which pins have one */
    uint32_t function_level, function_driven; /* levels of peripherals at pins with a function */
    uint32_t level; /* of the pins, as last reported */
} gpio_port_t;

typedef struct {
    soc_t *soc;
    gpio_port_t port[SOC_PORTS];
    uint32_t imr, emr, rtsr, ftsr, pr; /* EXTI */
    uint32_t exticr[4];
} gpio_t;

uint32_t gpio_read(void *gpio, uint32_t offset); /* from GPIOA on */
void gpio_write(void *gpio, uint32_t offset, uint32_t value);
uint32_t gpio_exti_read(void *gpio, uint32_t offset);
void gpio_exti_write(void *gpio, uint32_t offset, uint32_t value);
uint32_t gpio_syscfg_read(void *gpio, uint32_t offset);
void gpio_syscfg_write(void *gpio, uint32_t offset, uint32_t value);
void gpio_reset(void *gpio, soc_reset_t cause);

/* A circuit outside drives a pin. */
void gpio_drive(gpio_t *gpio, unsigned pin, bool level);

/* A peripheral drives a pin that has this function, or leaves it. */
void gpio_function(gpio_t *gpio, unsigned pin, bool driven, bool level);

/* Level at a pin: of its output, from outside, or by its resistor; a floating pin is low. */
bool gpio_level(const gpio_t *gpio, unsigned pin);

/* True if the pin is given to this alternate function. */
bool gpio_has_function(const gpio_t *gpio, unsigned pin, unsigned function);
bool gpio_is_analog(const gpio_t *gpio, unsigned pin);

#endif
