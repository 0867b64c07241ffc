/* digest.h - check value over all outputs of a core, equal on every machine. */
#ifndef TARGETS_DIGEST_H
#define TARGETS_DIGEST_H

#include "app/servo.h"
#include "exchange.h"

/* CRC-32 over words, low byte first. */
#define DIGEST_START UINT32_C(0xFFFFFFFF)
uint32_t digest_word(uint32_t value, uint16_t word);
uint32_t digest_long(uint32_t value, uint32_t word);

#define DIGEST_FIELDS_MAX 256

typedef struct {
    uint16_t at; /* offset in servo_t */
    bool wide;   /* 32 bits, else 16 */
} digest_field_t;

typedef struct {
    uint32_t value;
    uint32_t tick;    /* of the last included snapshot */
    uint32_t periods; /* M2 calls so far */
    digest_field_t field[DIGEST_FIELDS_MAX]; /* scalars of the snapshot, kept because a search of the table is slow */
    uint16_t fields;
} digest_t;

/* False if the snapshot has more scalars than DIGEST_FIELDS_MAX. */
bool digest_init(digest_t *digest);

/* After each call: its kind, the numbers of recorded inputs not read and of missing inputs, its words out, and the
 * snapshot if it is new. */
void digest_call(digest_t *digest, call_t call, uint16_t axis, uint16_t left, uint16_t missing, const out_log_t *out,
                 const servo_t *servo);

/* The scalars of the snapshot: entry `i` of the table of variables if it is one of them. */
bool digest_snapshot_field(const servo_t *servo, uint16_t i, uint32_t *value);

#endif
