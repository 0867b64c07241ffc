/* xbar.h - crossbars A and B and the AND-OR-INVERT unit between them.
 *
 * Nothing is evaluated without a cause: a trigger pulse or a level that changes is followed to the inputs of peripherals
 * that it reaches.
 */
#ifndef CHIP_XBAR_H
#define CHIP_XBAR_H

#include <stdint.h>

#define XBARA_INPUTS 50
#define XBARA_OUTPUTS 59
#define XBARB_INPUTS 26
#define XBARB_OUTPUTS 16
#define AOI_EVENTS 4

typedef enum { XBAR_FALL = 0, XBAR_RISE = 1, XBAR_PULSE = 2 } xbar_edge_t;

typedef struct {
    uint16_t a_select[30]; /* XBARA_SEL0-29 */
    uint16_t b_select[8];  /* XBARB_SEL0-7 */
    uint16_t bfcrt[2 * AOI_EVENTS];
    /* what follows from them */
    uint16_t truth[AOI_EVENTS];     /* bit i: result for the inputs i (bit 0 A .. bit 3 D) */
    uint64_t reaches[XBARA_INPUTS]; /* bit per output of crossbar A */
    unsigned feeds[XBARB_INPUTS];   /* bit per input of the AOI */
    unsigned aoi_in;                /* levels on the sixteen inputs of the AOI */
    uint64_t level;                 /* levels on the inputs of crossbar A */
    uint32_t b_level;               /* and B */
} xbar_t;

#endif
