/* rcc.h - reset and clock control, and the voltage scale of the power control. */
#ifndef STM32F405_RCC_H
#define STM32F405_RCC_H

#include "stm32f405/soc.h"

typedef struct {
    soc_t *soc;
    uint32_t cr, pllcfgr, cfgr, csr; /* without ready flags */
    uint32_t pwr_cr;
    uint32_t flash_latency; /* as the FLASH has it */
    uint64_t hse_clock, pll_clock, lsi_clock; /* at which they are ready; CHIP_NEVER while off */
} rcc_t;

uint32_t rcc_read(void *rcc, uint32_t offset);
void rcc_write(void *rcc, uint32_t offset, uint32_t value);
uint32_t rcc_pwr_read(void *rcc, uint32_t offset);
void rcc_pwr_write(void *rcc, uint32_t offset, uint32_t value);
void rcc_reset(void *rcc, soc_reset_t cause);

#endif
