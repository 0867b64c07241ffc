#include "comm/payload.h"

#include <string.h>

#include "comm/leb128.h"

#define OPERATION_HEAD 2u /* code and length */

const uint8_t *payload_take(payload_reader_t *reader, uint32_t size)
{
    if (size > reader->remaining) {
        reader->missing = true;
        reader->remaining = 0;
        return NULL;
    }
    const uint8_t *data = reader->data;
    reader->data += (size_t)size;
    reader->remaining = (uint16_t)(reader->remaining - size);
    return data;
}

uint8_t payload_get_u8(payload_reader_t *reader)
{
    const uint8_t *data = payload_take(reader, 1);
    return data != NULL ? *data : (uint8_t)0;
}

/* Advance by a number that took `used` bytes; 0 means that the payload ended within the number. */
static void step(payload_reader_t *reader, uint16_t used)
{
    (void)payload_take(reader, used != 0 ? (uint32_t)used : (uint32_t)reader->remaining + 1u);
}

uint32_t payload_get_unsigned(payload_reader_t *reader)
{
    uint32_t value = 0;
    step(reader, leb128_get_unsigned(reader->data, reader->remaining, &value));
    return value;
}

int32_t payload_get_signed(payload_reader_t *reader)
{
    int32_t value = 0;
    step(reader, leb128_get_signed(reader->data, reader->remaining, &value));
    return value;
}

bool payload_next_operation(payload_reader_t *list, payload_operation_t *operation)
{
    if (list->remaining < OPERATION_HEAD) {
        return false;
    }
    operation->code = payload_get_u8(list);
    const uint8_t length = payload_get_u8(list);
    const uint8_t *data = payload_take(list, length);
    operation->operand = (payload_reader_t){data, length, false};
    return data != NULL;
}

uint8_t *payload_reserve(payload_writer_t *writer, uint32_t size)
{
    if (writer->full || size > (uint32_t)(writer->room - writer->size)) {
        writer->full = true;
        return NULL;
    }
    uint8_t *data = writer->data + writer->size;
    writer->size = (uint16_t)(writer->size + size);
    return data;
}

void payload_put_bytes(payload_writer_t *writer, const uint8_t *data, uint16_t size)
{
    uint8_t *room = payload_reserve(writer, size);
    if (room != NULL) {
        memcpy(room, data, size);
    }
}

void payload_put_u8(payload_writer_t *writer, uint8_t value) { payload_put_bytes(writer, &value, 1); }

void payload_put_unsigned(payload_writer_t *writer, uint32_t value)
{
    uint8_t bytes[LEB128_SIZE_MAX];
    payload_put_bytes(writer, bytes, leb128_put_unsigned(bytes, value));
}

void payload_put_string(payload_writer_t *writer, const char *text)
{
    do {
        payload_put_u8(writer, (uint8_t)*text);
    } while (*text++ != '\0' && !writer->full);
}
