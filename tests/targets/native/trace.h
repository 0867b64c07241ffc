/* trace.h - a recording as a stream of bytes: the called entry points, and the words in of each call.
 *
 *   header   "SRVT", then three 32-bit numbers, low byte first: periods between two check values, first and last period
 *            of which every call is to be printed
 *   calls    kind, axis, number of words, one byte each, and the words, low byte first; CALL_END is the last one
 */
#ifndef TARGETS_TRACE_H
#define TARGETS_TRACE_H

#include <stdbool.h>
#include <stdint.h>

#include "exchange.h"

#define TRACE_NAME UINT32_C(0x54565253)

typedef struct {
    call_t call;
    uint16_t axis;
    uint16_t size;
    uint16_t in[EXCHANGE_IN_MAX];
} trace_call_t;

/* Read byte `at` of the recording. */
typedef uint8_t (*trace_fetch_t)(uint32_t at);

typedef struct {
    trace_fetch_t fetch;
    uint32_t check_every;
    uint32_t print_first, print_last; /* periods */
    uint32_t at;
} trace_reader_t;

/* False if the bytes are not a recording. */
bool trace_reader_open(trace_reader_t *reader, trace_fetch_t fetch);

/* False at the end. */
bool trace_reader_next(trace_reader_t *reader, trace_call_t *call);

#endif
