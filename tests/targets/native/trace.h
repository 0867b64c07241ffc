/* trace.h - a recording as a short stream of bytes: which entry points were called, and the words in of each call.
 *
 *   header   "SRVT", then three 32-bit numbers, low byte first: periods between two check values, first and last period
 *            of which every call is to be printed
 *   body     bits, most significant first. Calls of one kind and one number of words form a shape; each call is coded
 *            against the last one of its shape.
 *     shape    0: the one that followed last time; 1 and 6 bits: its number. One more than known so far: a new one, its
 *              kind (4 bits), axis (4 bits) and number of words (8 bits) follow.
 *     calm     only if some word of the shape has been quiet, that is as predicted for a while. 0: all of those are
 *              again.
 *     words    difference to the prediction, folded to 0, 1, 2... for 0, -1, 1..., in a Rice code whose parameter and
 *              whose prediction (same value, or same step again) follow what the word has been doing. In a calm call
 *              the quiet words are left out.
 *
 * Reader and writer keep the same model of every word and learn in step.
 */
#ifndef TARGETS_TRACE_H
#define TARGETS_TRACE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "exchange.h"

#define TRACE_SHAPES 63
#define TRACE_SHAPE_BITS 6
#define TRACE_WORDS 480      /* of all shapes together */
#define TRACE_ESCAPE 14      /* ones of a Rice code; so many mean that 16 plain bits follow */
#define TRACE_SUCCESSOR_NONE 255

typedef struct {
    uint16_t last;
    uint16_t step;     /* last difference */
    uint8_t error[2]; /* eight times the mean folded error of "same value" and of "same step", see trace_model.c */
} trace_word_t;

typedef struct {
    uint8_t call;
    uint8_t axis;
    uint8_t size;
    uint8_t successor;
    uint16_t first; /* of its words in the pool */
} trace_shape_t;

typedef struct {
    trace_shape_t shape[TRACE_SHAPES];
    trace_word_t word[TRACE_WORDS];
    uint16_t shapes;
    uint16_t words;
    uint16_t current; /* shape of the last call */
} trace_model_t;

void trace_model_init(trace_model_t *model);

/* Add a shape; false when there is no room. */
bool trace_model_add(trace_model_t *model, uint8_t call, uint8_t axis, uint8_t size);

uint16_t trace_word_prediction(const trace_word_t *word);
uint16_t trace_word_parameter(const trace_word_t *word);
bool trace_word_quiet(const trace_word_t *word);
void trace_word_learn(trace_word_t *word, uint16_t value);

typedef struct {
    call_t call;
    uint16_t axis;
    uint16_t size;
    uint16_t in[EXCHANGE_IN_MAX];
} trace_call_t;

/* Fetch byte `at` of the recording. */
typedef uint8_t (*trace_fetch_t)(uint32_t at);

typedef struct {
    trace_fetch_t fetch;
    uint32_t check_every;
    uint32_t print_first, print_last; /* periods */
    uint32_t at;
    uint16_t buffer;
    uint16_t bits; /* in `buffer` */
    trace_model_t model;
} trace_reader_t;

/* False when the bytes are no recording. */
bool trace_reader_open(trace_reader_t *reader, trace_fetch_t fetch);

/* False at the end, and for ever after. */
bool trace_reader_next(trace_reader_t *reader, trace_call_t *call);

#endif
