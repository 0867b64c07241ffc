/* sci.h - QSCI0-2 and the serial line to the host. Clocks are those of the bus (10 ns).
 */
#ifndef CHIP_SCI_H
#define CHIP_SCI_H

#include "chip/bus.h"
#include "serial_line.h"

#define SCI_BASE 0xE080u
#define SCI_END 0xE0B0u

#define SCI_FIFO 4         /* bytes */

typedef struct {
    uint16_t rate, ctrl1, ctrl2, ctrl3; /* registers */
    uint16_t errors;                    /* PF FE NF OR of STAT */
    bool stat_read;                     /* first step of clearing a flag */
    uint8_t rx[SCI_FIFO];
    unsigned rx_count; /* bytes */
    uint8_t tx[SCI_FIFO];
    unsigned tx_count;    /* bytes */
    uint8_t shift;        /* byte on the wire */
    uint64_t shift_clock; /* at which it is complete; CHIP_NEVER without one */
} sci_module_t;

typedef struct {
    bus_t *bus;
    sci_module_t module[SCI_MODULES];
    unsigned sender, receiver; /* modules that are routed to the line; SCI_MODULES: none */
    serial_line_t line;
} sci_t;

void sci_init(sci_t *sci, bus_t *bus, double baud);

uint16_t sci_read(void *sci, uint32_t address);
void sci_write(void *sci, uint32_t address, uint16_t value);
void sci_reset(void *sci);
void sci_event(void *sci, unsigned source);

/* The host sends: serial_line_write. */
size_t sci_line_write(sci_t *sci, const uint8_t *data, size_t size);

/* Clock at which the next byte on the wire is complete; CHIP_NEVER without one. */
uint64_t sci_line_next(const sci_t *sci);

#endif
