/* chip.h - the STM32F405 as far as a servo uses it, with the gate drivers behind its SPI, without its core (program.h).
 *
 * Time is counted in clocks of 168 MHz since power-on. What is not modelled is an error that ends the run and names the register.
 */
#ifndef STM32F405_CHIP_H
#define STM32F405_CHIP_H

#include "stm32f405/adc.h"
#include "stm32f405/dma.h"
#include "stm32f405/drv8301.h"
#include "stm32f405/flash_control.h"
#include "stm32f405/gpio.h"
#include "stm32f405/iwdg.h"
#include "stm32f405/rcc.h"
#include "stm32f405/spi.h"
#include "stm32f405/tim.h"
#include "stm32f405/usart.h"

#define CHIP_AXES 2u
#define CHIP_PHASES 3u

typedef struct {
    double baud; /* of the host [bit/s] */
    const uint8_t *flash; /* image of the storage; NULL: erased */
    uint64_t seed; /* of its contents after a power failure */
    unsigned enable_pin, select_pin[DRV8301_DRIVERS], fault_pin; /* of the gate drivers */
    uint8_t *(*memory)(void *board, uint32_t address, unsigned size); /* for DMA and storage; NULL: there is none */
} chip_config_t;

typedef struct chip {
    soc_t soc;
    gpio_t gpio;
    tim_t tim[SOC_TIMERS];
    adc_t adc;
    dma_t dma;
    usart_t usart;
    spi_t spi;
    flash_control_t flash_control;
    iwdg_t iwdg;
    rcc_t rcc;
    drv8301_t drivers;
    unsigned enable_pin, select_pin[DRV8301_DRIVERS], fault_pin;
    uint8_t *(*memory)(void *board, uint32_t address, unsigned size);
    uint32_t dbgmcu[2];
    unsigned gates[CHIP_AXES][CHIP_PHASES]; /* levels that the power stage has */
} chip_t;

/* Power on. */
void chip_init(chip_t *chip, const chip_config_t *config, const chip_environment_t *environment, void *board);

/* Access by the core; false: there is nothing, or not of this size. */
bool chip_load(void *chip, uint32_t address, unsigned size, uint32_t *value);
bool chip_store(void *chip, uint32_t address, unsigned size, uint32_t value);
void chip_reset_by_software(void *chip); /* does not return */
void chip_power_on(void *chip); /* reset by the supply: power-on, brown-out */

/* The memory of the program shows the storage from now on. */
void chip_show_storage(chip_t *chip);

/* ---- for the board: as chip/chip.h ---------------------------------------------------------------------------------- */

void chip_pin(chip_t *chip, unsigned pin, bool level);
bool chip_pin_level(const chip_t *chip, unsigned pin);
int32_t chip_peek(chip_t *chip, uint32_t address);
int chip_poke(chip_t *chip, uint32_t address, uint16_t value);

/* All edges are events. */
static inline unsigned chip_deferrable_edges(const chip_t *chip, unsigned pin)
{
    (void)chip;
    (void)pin;
    return 0;
}

static inline void chip_pin_late(chip_t *chip, unsigned pin, bool level, uint64_t clock)
{
    (void)clock;
    chip_pin(chip, pin, level);
}

static inline void chip_plant_changed(chip_t *chip) { (void)chip; }

#define chip_line_write(chip, data, size) usart_line_write(&(chip)->usart, data, size)
#define chip_line_next(chip) usart_line_next(&(chip)->usart)

#endif
