/* payload.h - reading of requests and writing of answers with bounds checks.
 *
 * A reader sets `missing` and returns zeros if data are missing, a writer sets `full` on overflow; so handlers read all
 * fields and check once.
 */
#ifndef COMM_PAYLOAD_H
#define COMM_PAYLOAD_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    const uint8_t *data; /* next byte */
    uint16_t remaining; /* received bytes not yet read */
    bool missing; /* more bytes were read than received */
} payload_reader_t;

typedef struct {
    uint8_t *data; /* first byte */
    uint16_t room; /* size of the buffer, bytes */
    uint16_t size; /* bytes written */
    bool full; /* more bytes were written than fit */
} payload_writer_t;

uint8_t payload_get_u8(payload_reader_t *reader);
uint32_t payload_get_unsigned(payload_reader_t *reader);
int32_t payload_get_signed(payload_reader_t *reader);

/* Next `size` bytes, or NULL. */
const uint8_t *payload_take(payload_reader_t *reader, uint32_t size);

/* Operation in a list: u8 code, u8 length, data. */
typedef struct {
    uint8_t code; /* FreeMASTER code of the operation */
    payload_reader_t operand;
} payload_operation_t;

/* Next operation of a list; false at its end. A single remaining byte is ignored; a truncated operation sets
 * `missing` of the list. */
bool payload_next_operation(payload_reader_t *list, payload_operation_t *operation);

/* Reserve `size` bytes in the answer; NULL: no room. */
uint8_t *payload_reserve(payload_writer_t *writer, uint32_t size);

void payload_put_u8(payload_writer_t *writer, uint8_t value);
void payload_put_unsigned(payload_writer_t *writer, uint32_t value);
void payload_put_bytes(payload_writer_t *writer, const uint8_t *data, uint16_t size);

/* Append the characters and the terminating 00. */
void payload_put_string(payload_writer_t *writer, const char *text);

#endif
