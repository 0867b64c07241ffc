/* spi.h - SPI3 as a master with frames of 16 bits; chip selects are pins. */
#ifndef STM32F405_SPI_H
#define STM32F405_SPI_H

#include "stm32f405/soc.h"

typedef struct {
    soc_t *soc;
    bool connected; /* the pins have the function */
    uint32_t cr1, cr2, flags; /* RXNE, OVR of SR */
    uint16_t rx, tx, shift;
    bool tx_full, busy;
} spi_t;

uint32_t spi_read(void *spi, uint32_t offset);
void spi_write(void *spi, uint32_t offset, uint32_t value);
void spi_reset(void *spi, soc_reset_t cause);
void spi_event(void *spi, unsigned source);

#endif
