/* xbar.h - crossbars A and B and the AND-OR-INVERT unit between them.
 *
 * Only changes are evaluated: a trigger pulse or a level that changes is followed to all inputs of peripherals that it is
 * routed to.
 */
#ifndef CHIP_XBAR_H
#define CHIP_XBAR_H

#include "chip/bus.h"

#define XBAR_BASE 0xE340u
#define XBAR_END 0xE388u

#define XBARA_INPUTS 50
#define XBARA_OUTPUTS 59
#define XBARB_INPUTS 26
#define XBARB_OUTPUTS 16
#define AOI_EVENTS 4

typedef struct {
    bus_t *bus;
    uint16_t a_select[30];          /* XBARA_SEL0-29 */
    uint16_t b_select[8];           /* XBARB_SEL0-7 */
    uint16_t bfcrt[2 * AOI_EVENTS]; /* AOI_BFCRT */
    /* derived from the registers */
    uint16_t truth[AOI_EVENTS];     /* bit i: result for the inputs i (bit 0 A .. bit 3 D) */
    uint64_t reaches[XBARA_INPUTS]; /* bit per output of crossbar A */
    unsigned feeds[XBARB_INPUTS];   /* bit per input of the AOI */
    /* levels, bit per input */
    unsigned aoi_in;
    uint64_t level; /* levels of crossbar A */
    uint32_t b_level;
} xbar_t;

uint16_t xbar_read(void *xbar, uint32_t address);
void xbar_write(void *xbar, uint32_t address, uint16_t value);
void xbar_reset(void *xbar);

/* Edge or pulse at an input of crossbar A and one of B; -1: none. */
void xbar_signal(xbar_t *xbar, int a_input, int b_input, xbar_edge_t edge);

#endif
