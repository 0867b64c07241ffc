/* sci.h - QSCI0-2 and the serial line to the host.
 *
 * Both ends have a bit rate of their own: a byte is sampled in the middle of the bits that the receiver expects, so that
 * wrong settings give wrong bytes and framing errors, as on a wire. Clocks are those of the bus (10 ns).
 */
#ifndef CHIP_SCI_H
#define CHIP_SCI_H

#include "chip/bus.h"

#define SCI_BASE 0xE080u
#define SCI_END 0xE0B0u

#define SCI_FIFO 4         /* bytes */
#define SCI_LINE_IN 4096   /* bytes that the host may write ahead of the wire */
#define SCI_LINE_OUT 65536 /* bytes that wait for the host */

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
    double byte_clocks; /* ten bits at the host's rate [clocks] */
    uint8_t in[SCI_LINE_IN];
    size_t in_head, in_size; /* bytes */
    uint64_t in_clock;       /* at which the byte on the wire is complete; CHIP_NEVER without one */
    uint8_t out[SCI_LINE_OUT];
    size_t out_head, out_size; /* bytes */
    uint32_t overruns;         /* received bytes that the software did not read in time */
    uint32_t lost;             /* sent bytes that the host did not read in time */
} sci_line_t;

typedef struct {
    bus_t *bus;
    sci_module_t module[SCI_MODULES];
    unsigned sender, receiver; /* modules that are routed to the line; SCI_MODULES: none */
    sci_line_t line;
} sci_t;

void sci_init(sci_t *sci, bus_t *bus, double baud);

uint16_t sci_read(void *sci, uint32_t address);
void sci_write(void *sci, uint32_t address, uint16_t value);
void sci_reset(void *sci);
void sci_event(void *sci, unsigned source);

/* The host's end of the line. Both return the number of bytes. */
size_t sci_line_write(sci_t *sci, const uint8_t *data, size_t size);
size_t sci_line_read(sci_t *sci, uint8_t *data, size_t room);

/* Clock at which the next byte on the wire is complete; CHIP_NEVER without one. */
uint64_t sci_line_next(const sci_t *sci);

#endif
