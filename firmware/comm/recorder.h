/* recorder.h - recorder: samples variables in every call of a loop, with triggers (SETREC, GETREC).
 *
 * The server configures a recorder in the background; the loop calls recorder_sample(), which may interrupt the
 * configuration. The address of a variable is converted to a pointer once, when a slot is set, after a check against the
 * table.
 * Differences from the vendor's driver:
 *   - slots have separate memory: LIMITS reports 0 bytes per recorder and per variable; CFGMEM refuses too many slots
 *     (86), where the vendor's driver overwrites memory
 *   - an operation that returns an error changes nothing; missing bytes are an error (86), not the bytes of older
 *     requests
 *   - all recorders share one sample memory: CFGMEM of one recorder releases it from another one, or returns 87 while
 *     that one is recording
 *   - samples can be read while no recorder is recording (otherwise 89)
 *   - constant thresholds have 32 bits; a threshold outside the range of its variable is never or always reached
 *   - no trigger on floating-point numbers (90)
 */
#ifndef COMM_RECORDER_H
#define COMM_RECORDER_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/payload.h"
#include "comm/status.h"
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
#define RECORDER_MODE_LEVEL 0x40u /* level trigger, otherwise edge trigger */
#define RECORDER_MODE_LIMIT_VARIABLE 0x80u

/* Provided by the application for each recorder. */
typedef struct {
    const char *name; /* name of the recorder */
    uint32_t timebase; /* interval of the calls of recorder_sample() [ns] */
} recorder_app_t;

/* Slot: one variable. */
typedef struct {
    const uint8_t *source; /* NULL: not set */
    const uint8_t *limit; /* variable used as threshold; NULL: constant threshold */
    uint32_t threshold; /* constant threshold, low 4 bytes; up to 4 bytes and signed: plus `bias`, at least 0 */
    uint32_t threshold_upper; /* constant threshold, upper 4 bytes of a signed 8-byte variable, XOR `bias` */
    uint32_t bias; /* XOR mask that maps signed numbers to unsigned numbers in the same order */
    uint8_t size; /* size of the variable, bytes */
    uint8_t cell; /* common cell size of source and limit, bytes */
    uint8_t mode; /* trigger byte of the request */
    uint8_t direct; /* 2, 4: size of a variable of one cell with constant threshold, bytes; 0: other cases */
    bool above; /* the last sample was at or above the threshold */
} recorder_slot_t;

/* State of the sampling. */
typedef struct {
    bool filled; /* the memory was filled once since the start */
    bool armed; /* the memory is filled and no trigger has occurred */
    bool stopping; /* a trigger has occurred */
    uint8_t cell; /* bytes per move */
    uint32_t skip; /* remaining calls without a sample */
    uint32_t divider; /* calls without a sample between two samples */
    uint16_t point; /* size of a point (one sample of all variables), bytes */
    uint8_t *next; /* next point */
    uint8_t *end; /* end of the last point */
    uint16_t remaining; /* remaining points after a trigger */
    uint16_t after; /* number of points after a trigger */
    recorder_slot_t *const *trigger_end;
    recorder_slot_t *trigger[RECORDER_SLOTS];
    const uint8_t *source[RECORDER_SLOTS * RECORDER_SLOT_BYTES]; /* source address of each move */
} recorder_sampling_t;

/* Sample memory and sampling state, used by the recorder that was configured last. */
typedef struct {
    uint32_t *samples; /* array of words, so that all variables are aligned */
    uint32_t size; /* size of `samples`, bytes */
    struct recorder *owner; /* recorder that uses the memory; NULL: none */
    recorder_slot_t slot[RECORDER_SLOTS];
    recorder_sampling_t sampling;
} recorder_memory_t;

typedef struct recorder {
    recorder_app_t app;
    recorder_memory_t *memory;
    volatile bool running; /* recording */
    uint8_t slots; /* slots in use */
    uint8_t stored; /* slots in use that are stored; the others are triggers only */
    bool configured; /* all slots are set; no further slot is accepted */
    bool started; /* was started since the configuration */
    uint32_t total; /* number of points; 0: as many as fit */
    uint32_t before; /* number of points before the trigger */
    uint32_t divider; /* configured number of calls without a sample between two samples */
} recorder_t;

void recorder_init(recorder_t *recorder, const recorder_app_t *app, recorder_memory_t *memory);

/* Execute the operations of a SETREC request up to the first error; the operations before it remain in effect. */
fm_status_t recorder_configure(recorder_t *recorder, const tsa_space_t *space, payload_reader_t *operations);

/* Answer one operation of GETREC. */
fm_status_t recorder_query(recorder_t *recorder, uint8_t operation, payload_writer_t *reply);

/* Samples at an address; NULL: none, or not readable while recording. */
const uint8_t *recorder_samples(const recorder_memory_t *memory, uint32_t address, uint32_t size);

/* Take a sample, or count a call without a sample. */
void recorder_take(recorder_t *recorder);

/* To be called in every call of the loop. */
static inline void recorder_sample(recorder_t *recorder)
{
    if (recorder->running) {
        recorder_take(recorder);
    }
}

#endif
