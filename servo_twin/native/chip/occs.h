/* occs.h - clock generation: oscillators, PLL, the bus clock. Clocks are those of the bus at 100 MHz (10 ns). */
#ifndef CHIP_OCCS_H
#define CHIP_OCCS_H

#include "chip/bus.h"

#define OCCS_BASE 0xE2B0u
#define OCCS_END 0xE2B9u

typedef struct {
    bus_t *bus;
    uint16_t ctrl, divby, osctl1, osctl2, prot; /* registers */
    uint64_t lock_clock;                        /* time at which the PLL is locked */
    uint64_t switch_clock;                      /* time at which ZSRCS equals ZSRC */
    uint64_t crystal_clock;                     /* time of OSC_OK */
} occs_t;

uint16_t occs_read(void *occs, uint32_t address);
void occs_write(void *occs, uint32_t address, uint16_t value);
void occs_reset(void *occs);

/* End the run unless the bus clock is CHIP_BUS_HZ; `part` starts and needs it. */
void occs_need_bus_clock(occs_t *occs, const char *part);

#endif
