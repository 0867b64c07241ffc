/* iwdg.h - independent watchdog, on the internal oscillator of nominally 32 kHz. */
#ifndef STM32F405_IWDG_H
#define STM32F405_IWDG_H

#include "stm32f405/soc.h"

typedef struct {
    soc_t *soc;
    uint32_t pr, rlr;
    bool unlocked, started;
    uint32_t services; /* since power-on */
} iwdg_t;

uint32_t iwdg_read(void *iwdg, uint32_t offset);
void iwdg_write(void *iwdg, uint32_t offset, uint32_t value);
void iwdg_reset(void *iwdg, soc_reset_t cause);
void iwdg_event(void *iwdg, unsigned source);

#endif
