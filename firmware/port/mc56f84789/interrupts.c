/* interrupts.c - priority levels and handlers of the interrupts. */
#include "port/mc56f84789/drivers.h"
#include "port/mc56f84789/port.h"
#include "port/mc56f84789/vectors.h"

typedef struct {
    uint16_t vector;
    uint16_t level;
} interrupt_t;

#define ENTRY(vector, level, handler) {vector, level},
static const interrupt_t interrupts[] = {PORT_VECTORS(ENTRY)};

void interrupts_init(hal_t *hal)
{
    for (uint16_t i = 0; i < INTC_IPRS; i++) {
        REG_WRITE(hal, INTC_BASE + i, 0U);
    }
    for (uint16_t i = 0; i < sizeof interrupts / sizeof interrupts[0]; i++) {
        const uint16_t vector = interrupts[i].vector;
        const uint16_t ipr = REG_READ(hal, INTC_IPR(vector));
        REG_WRITE(hal, INTC_IPR(vector), ipr | INTC_LEVEL(vector, interrupts[i].level));
    }
}

#define CASE(vector, level, handler)                                                                                   \
    case vector:                                                                                                       \
        handler(hal);                                                                                                  \
        break;

void port_isr(hal_t *hal, uint16_t vector)
{
    switch (vector) {
        PORT_VECTORS(CASE)
    default:
        break;
    }
}
