/* recorder.h - samples of variables in every call of a loop, with triggers (SETREC, GETREC).
 *
 * The server configures in the background; the loop calls recorder_sample(), which may interrupt it at any point. An address
 * becomes a pointer once, when a slot is set, and only if the table allows it. Where the vendor's driver is left:
 *   - slots have a memory of their own: LIMITS says 0 bytes for a recorder and for a variable, and CFGMEM refuses more
 *     slots than there are (86) where the vendor overwrites memory
 *   - an operation that answers an error has changed nothing; missing bytes are an error (86), not those of older requests
 *   - all recorders share one memory: CFGMEM of one takes it from the other, or answers 87 while that one records
 *   - samples can be read while nothing is recorded (89 meanwhile)
 *   - constant thresholds have 32 bits; one that its variable cannot hold is never or always reached
 *   - a trigger on a floating-point number is not there (90)
 */
#ifndef COMM_RECORDER_H
#define COMM_RECORDER_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/payload.h"
#include "comm/tsa.h"

#define RECORDER_SLOTS 8
#define RECORDER_SLOT_BYTES 8 /* largest variable */

/* Trigger byte of a request. */
#define RECORDER_MODE_TYPE 0x03u
#define RECORDER_TYPE_NONE 0u
#define RECORDER_TYPE_SIGNED 2u
#define RECORDER_TYPE_FLOAT 3u
#define RECORDER_MODE_NOT_STORED 0x04u
#define RECORDER_MODE_ABOVE 0x10u
#define RECORDER_MODE_BELOW 0x20u
#define RECORDER_MODE_LEVEL 0x40u /* instead of an edge */
#define RECORDER_MODE_LIMIT_VARIABLE 0x80u

/* What the application lends for one recorder. */
typedef struct {
    const char *name;
    uint32_t timebase; /* time from one recorder_sample() to the next [ns] */
} recorder_app_t;

/* One variable. */
typedef struct {
    const uint8_t *source; /* NULL: not set */
    const uint8_t *limit;  /* variable that is the threshold; NULL: it is constant */
    uint32_t threshold;    /* constant; signed ones shifted by `bias`, as what they are compared with */
    uint32_t threshold_upper; /* the same of 8 bytes */
    uint32_t bias; /* makes signed numbers unsigned ones in the same order */
    uint8_t size; /* bytes of the variable */
    uint8_t cell; /* of source and limit */
    uint8_t mode; /* trigger byte of the request */
    uint8_t direct; /* 2, 4: the number is one cell, and the threshold constant; 0: neither */
    bool above; /* at or above the threshold in the last sample */
} recorder_slot_t;

/* What a sample needs. */
typedef struct {
    bool filled;   /* once, since the start */
    bool armed;    /* .. and no trigger has fired */
    bool stopping; /* one has */
    uint8_t cell;  /* bytes that are moved at once */
    uint32_t skip;    /* calls to leave out */
    uint32_t divider; /* .. between two samples */
    uint16_t point; /* bytes */
    uint8_t *next; /* point */
    uint8_t *end;  /* of the last one */
    uint16_t left;  /* points to come once a trigger has fired */
    uint16_t after; /* .. at first */
    recorder_slot_t *const *trigger_end;
    recorder_slot_t *trigger[RECORDER_SLOTS];
    const uint8_t *source[RECORDER_SLOTS * RECORDER_SLOT_BYTES]; /* of each move */
} recorder_sampling_t;

/* Samples and what leads to them, of one recorder at a time: of the one that was configured last. */
typedef struct {
    uint32_t *samples; /* words, so that every variable is aligned in it */
    uint32_t size; /* bytes */
    struct recorder *owner; /* NULL: none yet */
    recorder_slot_t slot[RECORDER_SLOTS];
    recorder_sampling_t sampling;
} recorder_memory_t;

typedef struct recorder {
    recorder_app_t app;
    recorder_memory_t *memory;
    volatile bool running;
    uint8_t slots;   /* in use */
    uint8_t stored;  /* of these; others are triggers only */
    bool configured; /* all slots are set, nothing more may be */
    bool started;    /* since then */
    uint32_t total;  /* points; 0: as many as fit */
    uint32_t before; /* .. before the trigger */
    uint32_t divider; /* the same, as configured */
} recorder_t;

void recorder_init(recorder_t *recorder, const recorder_app_t *app, recorder_memory_t *memory);

/* Carry out the operations of a SETREC request up to the first error; what was done before it stays done. */
uint8_t recorder_configure(recorder_t *recorder, const tsa_space_t *space, payload_reader_t *operations);

/* Answer an operation of GETREC. */
uint8_t recorder_query(recorder_t *recorder, uint8_t operation, payload_writer_t *reply);

/* The samples at an address; NULL if they are not there, or not to be read now. */
const uint8_t *recorder_samples(const recorder_memory_t *memory, uint32_t address, uint32_t size);

/* Take a sample, unless it is not time for one yet. */
void recorder_take(recorder_t *recorder);

/* In every call of the loop. */
static inline void recorder_sample(recorder_t *recorder)
{
    if (recorder->running) {
        recorder_take(recorder);
    }
}

#endif
