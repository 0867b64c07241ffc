/* qtmr.h - quad timers A and B: four channels each, which share four inputs.
 *
 * Channels that count the bus clock are functions of time, brought up to date when they are read or when one of their
 * events has a consequence. Channels that count edges are stepped by them. Edges of which nothing but a count follows are
 * deferrable: the environment may report them later, with their clocks, and those behind a filter are no events.
 * Clocks are those of the bus (10 ns).
 */
#ifndef CHIP_QTMR_H
#define CHIP_QTMR_H

#include "chip/bus.h"

#define QTMR_BASE 0xE140u
#define QTMR_END 0xE1C0u

#define QTMR_DEFERRABLE_EDGES_MAX 100u

typedef struct {
    uint16_t reg[12]; /* COMP1 to FILT in the order of their addresses */
    bool oflag;
    uint64_t since; /* clock up to which a channel on the bus clock has counted */
} qtmr_channel_t;

typedef struct {
    qtmr_channel_t channel[QTMR_CHANNELS];
    unsigned module;                      /* 0: A, 1: B */
    uint16_t enable;                      /* ENBL */
    unsigned holds;                       /* channels on the bus clock whose HOLD is not computed yet */
    uint64_t hold_clock;                  /* clock for which HOLD is to be computed */
    unsigned raw;                         /* levels at the inputs, bit per input */
    unsigned in;                          /* levels behind the filters */
    uint64_t change_clock[QTMR_CHANNELS]; /* time at which a new level passes the filter; CHIP_NEVER: none */
    uint32_t delay[QTMR_CHANNELS];        /* delay of the filter of an input [clocks] */
    uint64_t quiet_clock;                 /* the first change_clock, if that edge is deferrable; else CHIP_NEVER */
    unsigned deferrable_edges;            /* number of coming edges whose only effect is a count */
    /* derived from the registers: masks of channels */
    unsigned on_bus;                      /* count the bus clock */
    unsigned eventful;                    /* channels on the bus clock whose compares and rollovers have an effect */
    unsigned cascade;                     /* count compares of another channel, in either direction */
    unsigned decodes[QTMR_CHANNELS];      /* decode quadrature from this input and another one */
    unsigned counts_edges[QTMR_CHANNELS]; /* count edges of this input */
    unsigned follows[QTMR_CHANNELS];      /* count the output of this channel */
    unsigned captures[QTMR_CHANNELS];     /* channels that capture at this input */
    unsigned captured; /* channels with IEF set: no further capture until software clears it */
    unsigned cleared_by[QTMR_CHANNELS]; /* channels whose OFLAG this input clears */
} qtmr_module_t;

typedef struct {
    bus_t *bus;
    uint64_t caught_up; /* clock up to which all deferred edges are counted */
    qtmr_module_t module[QTMR_MODULES];
} qtmr_t;

uint16_t qtmr_read(void *qtmr, uint32_t address);
void qtmr_write(void *qtmr, uint32_t address, uint16_t value);
void qtmr_reset(void *qtmr);
void qtmr_event(void *qtmr, unsigned source);

/* Level at an input from `clock` on: the present one, or an earlier one if the module has deferrable edges. */
void qtmr_input(qtmr_t *qtmr, unsigned module, unsigned input, bool level, uint64_t clock);

/* Pulse of one clock at an input. */
void qtmr_pulse(qtmr_t *qtmr, unsigned module, unsigned input);

/* Count all deferred edges up to the present clock. */
void qtmr_catch_up(qtmr_t *qtmr);

/* The clock gates in the SIM have changed. */
void qtmr_gates_changed(qtmr_t *qtmr);

#endif
