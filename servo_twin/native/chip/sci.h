/* sci.h - QSCI0-2 and the serial line to the host.
 *
 * Both ends have a speed of their own: a byte is sampled in the middle of the bits that the receiver believes in, so that
 * wrong settings give wrong bytes and framing errors, as on a wire.
 */
#ifndef CHIP_SCI_H
#define CHIP_SCI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define SCI_MODULES 3
#define SCI_FIFO 4
#define SCI_LINE_IN 4096   /* bytes that the host may hand over ahead of the wire */
#define SCI_LINE_OUT 65536 /* bytes that wait for the host */

typedef struct {
    uint16_t rate, ctrl1, ctrl2, ctrl3;
    uint16_t errors;      /* PF FE NF OR */
    bool stat_read;       /* first step of clearing a flag */
    uint8_t rx[SCI_FIFO];
    unsigned rx_count;
    uint8_t tx[SCI_FIFO];
    unsigned tx_count;
    uint8_t shift;        /* byte on the wire */
    uint64_t shift_clock; /* when it has left; CHIP_NEVER without one */
} sci_t;

typedef struct {
    double byte_clocks; /* ten bits of the host */
    uint8_t in[SCI_LINE_IN];
    size_t in_head, in_size;
    uint64_t in_clock;  /* when the byte on the wire is complete; CHIP_NEVER without one */
    uint8_t out[SCI_LINE_OUT];
    size_t out_head, out_size;
    uint32_t overruns;  /* received bytes that the software did not fetch in time */
    uint32_t lost;      /* sent bytes that the host did not fetch in time */
} sci_line_t;

#endif
