/* intc.h - interrupt controller: priority levels of the vectors, and which request is served next. */
#ifndef CHIP_INTC_H
#define CHIP_INTC_H

#include "chip/bus.h"

#define INTC_BASE 0xE300u
#define INTC_END 0xE31Cu
#define INTC_VECTORS 111
#define INTC_LEVELS 3 /* priority levels of peripherals */

typedef struct {
    bus_t *bus;
    uint16_t ipr[13], vba, ctrl;      /* registers */
    uint64_t enabled[INTC_LEVELS][2]; /* bit per vector that has this level */
} intc_t;

uint16_t intc_read(void *intc, uint32_t address);
void intc_write(void *intc, uint32_t address, uint16_t value);
void intc_reset(void *intc);

/* The most urgent request above `level`, the lower vector of two at one level; false if there is none. */
bool intc_most_urgent(const intc_t *intc, int level, unsigned *vector, int *its_level);

#endif
