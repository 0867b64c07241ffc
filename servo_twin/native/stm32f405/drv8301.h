/* drv8301.h - the gate drivers of both axes: their registers over SPI, gain, latched faults, the common nFAULT line.
 *
 * EN_GATE low switches all gates off and, longer than a reset pulse, loses the registers; DRV8301_START_CLOCKS after it rises the
 * driver works. A frame is executed when its chip select rises; the answer to a read comes in the next frame, that to a write is
 * status register 1 (assumed). The threshold of the over-current comparators is a value of the plant, OC_ADJ_SET has no effect on it.
 * Not modelled: supply and temperature faults, the current limit of OCP_MODE 0 beyond the time of the over-current itself.
 */
#ifndef STM32F405_DRV8301_H
#define STM32F405_DRV8301_H

#include "stm32f405/soc.h"

#define DRV8301_DRIVERS 2u
#define DRV8301_START_CLOCKS 1680000u /* 10 ms */

typedef struct {
    bool selected; /* nCS is low */
    unsigned frames; /* since it fell */
    uint16_t frame, answer;
    uint16_t status1, control1, control2;
    bool over_current; /* output of the comparators */
    bool latched; /* gates are off until a reset */
} drv8301_driver_t;

typedef struct {
    soc_t *soc;
    bool enabled; /* EN_GATE */
    uint64_t ready_clock; /* at which the drivers work; CHIP_NEVER while disabled */
    drv8301_driver_t driver[DRV8301_DRIVERS];
} drv8301_t;

void drv8301_init(drv8301_t *drv, soc_t *soc);
void drv8301_event(void *drv, unsigned source);

/* Pins: EN_GATE, chip selects. */
void drv8301_enable(drv8301_t *drv, bool level);
void drv8301_select(drv8301_t *drv, unsigned driver, bool level);

/* A frame of 16 bits, to the selected driver; without one, or with both, the line floats. */
uint16_t drv8301_exchange(drv8301_t *drv, uint16_t frame);

/* The comparators of an axis. */
void drv8301_over_current(drv8301_t *drv, unsigned driver, bool tripped);

bool drv8301_drives(const drv8301_t *drv, unsigned driver); /* gates follow their inputs */
bool drv8301_fault_pin(const drv8301_t *drv); /* level of nFAULT */
unsigned drv8301_gain(const drv8301_t *drv, unsigned driver); /* 10, 20, 40, 80 */
bool drv8301_calibrates(const drv8301_t *drv, unsigned driver,
                        unsigned channel); /* inputs of amplifier 1, 2 are shorted */

#endif
