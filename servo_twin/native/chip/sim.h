/* sim.h - system integration module: clock gates, function selects, reset status. What acts on other peripherals is in
 * sim_control_t. */
#ifndef CHIP_SIM_H
#define CHIP_SIM_H

#include "chip/bus.h"

#define SIM_BASE 0xE400u
#define SIM_END 0xE42Eu

typedef struct {
    bus_t *bus;
    reset_cause_t cause;                                           /* cause of the last reset */
    uint16_t ctrl, rstat, scr[4], sd[4], prot, misc0, pwrmode; /* registers */
} sim_t;

uint16_t sim_read(void *sim, uint32_t address);
void sim_write(void *sim, uint32_t address, uint16_t value);
void sim_reset(void *sim);

#endif
