/* cop.h - watchdog. */
#ifndef CHIP_COP_H
#define CHIP_COP_H

#include "chip/bus.h"

#define COP_BASE 0xE320u
#define COP_END 0xE324u

typedef struct {
    bus_t *bus;
    uint16_t ctrl, tout, intval; /* registers */
    uint64_t start_clock;        /* bus clock at which the count was TOUT */
    bool half_served;            /* 5555 has been written */
    uint32_t services;           /* since power-on */
} cop_t;

uint16_t cop_read(void *cop, uint32_t address);
void cop_write(void *cop, uint32_t address, uint16_t value);
void cop_reset(void *cop);
void cop_event(void *cop, unsigned source);

#endif
