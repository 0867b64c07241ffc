/* trace.h - events as a logic analyser would record them, while there is a buffer. */
#ifndef CHIP_TRACE_H
#define CHIP_TRACE_H

#include <stddef.h>
#include <stdint.h>

/* CFFI-BEGIN */
typedef enum {
    TRACE_CYCLE,     /* a counter starts from INIT: a = 4 module + submodule, b = INIT */
    TRACE_MATCH,     /* a compare that is an event matches: a = 4 module + submodule, b = number of the VAL */
    TRACE_LOAD,      /* buffered registers become active: a = 4 module + submodule */
    TRACE_GATES,     /* a pair of pins: a = 4 module + submodule, b = levels (bit 0 upper, bit 1 lower) */
    TRACE_TRIGGER,   /* a pulse into crossbar A: a = its input */
    TRACE_SYNC,      /* a sync pulse at the ADC: a = converter, b = 1 if it has started a scan */
    TRACE_SAMPLE,    /* a channel is held: a = sample, b = channel */
    TRACE_SCAN_END,  /* a scan is complete: a = converter */
    TRACE_ENTER,     /* a handler starts: a = vector, b = level */
    TRACE_LEAVE,     /* a handler ends: a = vector */
    TRACE_WRITE,     /* a register: a = address, b = value */
    TRACE_CAPTURE,   /* a timer captures: a = 4 module + channel, b = value */
} trace_kind_t;

typedef struct { /* without padding: the same run gives the same bytes */
    uint64_t clock; /* clocks of 10 ns since power-on */
    uint16_t kind, a;
    uint32_t b;
} trace_entry_t;
/* CFFI-END */

typedef struct {
    trace_entry_t *entry;
    size_t size; /* entries */
    size_t remaining; /* free entries; nothing is written without one */
} trace_t;

#endif
