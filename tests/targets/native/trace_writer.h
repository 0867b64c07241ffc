/* trace_writer.h - the writing side of trace.h; for the host only. */
#ifndef TARGETS_TRACE_WRITER_H
#define TARGETS_TRACE_WRITER_H

#include "trace.h"

typedef struct {
    uint8_t *bytes; /* grows as needed */
    size_t size;
    size_t room;
    uint8_t pending;
    uint16_t bits; /* in `pending` */
    bool failed;   /* out of memory, or more shapes than there is room for */
    trace_model_t model;
} trace_writer_t;

void trace_writer_open(trace_writer_t *writer, uint32_t check_every);
void trace_writer_put(trace_writer_t *writer, const trace_call_t *call);

/* Write the end; `bytes` and `size` stay valid until the writer is freed. */
void trace_writer_close(trace_writer_t *writer);
void trace_writer_free(trace_writer_t *writer);

#endif
