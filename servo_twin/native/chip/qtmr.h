/* qtmr.h - quad timers A and B: four channels each, which share four inputs.
 *
 * Channels that count the bus clock are functions of time, brought up to date when they are read or when one of their
 * events has a consequence. Channels that count edges are stepped by them. While a module has deferrable edges these only
 * count: it may hear of them late, and what waits behind its filters is no event.
 */
#ifndef CHIP_QTMR_H
#define CHIP_QTMR_H

#include <stdbool.h>
#include <stdint.h>

#define QTMR_MODULES 2
#define QTMR_CHANNELS 4
#define QTMR_DEFERRABLE_EDGES_MAX 100u /* at most [edges] */

typedef struct {
    uint16_t comp1, comp2, capt, load, hold, cntr, ctrl, sctrl, cmpld1, cmpld2, csctrl, filt;
    bool oflag;
    uint64_t since; /* clock to which a channel on the bus clock has been brought up */
} qtmr_channel_t;

typedef struct {
    qtmr_channel_t channel[QTMR_CHANNELS];
    unsigned module;
    uint16_t enable;
    unsigned holds;                      /* channels on the bus clock whose HOLD is still to be taken, ... */
    uint64_t hold_clock;                 /* ... as of this clock */
    unsigned raw;                        /* levels on the inputs, bit per input */
    unsigned in;                         /* behind the filters */
    uint64_t change_clock[QTMR_CHANNELS]; /* when the filter of an input will let its level through */
    uint32_t delay[QTMR_CHANNELS];       /* of that filter */
    uint64_t quiet_clock; /* the first such clock, if it is no event: that edge only counts; else CHIP_NEVER */
    unsigned deferrable_edges; /* so many edges to come would only count, too */
    /* what follows from the registers */
    unsigned on_bus; /* channels that count the bus clock */
    unsigned heard; /* those of them whose compares and rollovers have a consequence */
    unsigned cascade; /* channels that count compares of a channel, in either direction */
    unsigned decodes[QTMR_CHANNELS]; /* channels that decode quadrature from an input and another one */
    unsigned counts_edges[QTMR_CHANNELS]; /* channels that count edges of an input */
    unsigned follows[QTMR_CHANNELS]; /* channels that count the output of a channel */
    unsigned captures[QTMR_CHANNELS]; /* channels that capture on an input, ... */
    unsigned captured; /* ... those that have, and wait for software to clear IEF */
    unsigned cleared_by[QTMR_CHANNELS]; /* channels whose OFLAG an input clears */
} qtmr_t;

#endif
