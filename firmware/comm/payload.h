/* payload.h - bounded reading of a request and bounded writing of an answer.
 *
 * Neither can leave its buffer. A reader that is asked for more than was received sets `missing` and
 * delivers zeros, a writer that runs full sets `full`: handlers read all fields first and check once.
 */
#ifndef COMM_PAYLOAD_H
#define COMM_PAYLOAD_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    const uint8_t *data; /* the next byte */
    uint16_t left;       /* bytes received and not yet read */
    bool missing;
} payload_reader_t;

typedef struct {
    uint8_t *data; /* the first byte */
    uint16_t room; /* bytes in all */
    uint16_t size; /* bytes written */
    bool full;
} payload_writer_t;

uint8_t payload_get_u8(payload_reader_t *reader);
uint32_t payload_get_unsigned(payload_reader_t *reader);
int32_t payload_get_signed(payload_reader_t *reader);

/* The next `size` bytes, or NULL. */
const uint8_t *payload_take(payload_reader_t *reader, uint32_t size);

/* One of a list of operations: u8 code, u8 length, data. */
typedef struct {
    uint8_t code; /* FreeMASTER code of the operation */
    payload_reader_t operand;
} payload_operation_t;

/* The next operation of a list; false at its end, where a single left-over byte is ignored, and where one is cut off, which
 * makes the list `missing`. */
bool payload_next_operation(payload_reader_t *list, payload_operation_t *operation);

/* Room for `size` more bytes, or NULL. */
uint8_t *payload_reserve(payload_writer_t *writer, uint32_t size);

void payload_put_u8(payload_writer_t *writer, uint8_t value);
void payload_put_unsigned(payload_writer_t *writer, uint32_t value);
void payload_put_bytes(payload_writer_t *writer, const uint8_t *data, uint16_t size);

/* The characters and the terminating 00. */
void payload_put_string(payload_writer_t *writer, const char *text);

#endif
