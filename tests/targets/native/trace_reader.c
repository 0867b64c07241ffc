#include "trace.h"

static uint16_t byte(trace_reader_t *reader)
{
    const uint8_t value = reader->fetch(reader->at);
    reader->at++;
    return value;
}

static uint16_t word(trace_reader_t *reader)
{
    const uint16_t low = byte(reader);
    return (uint16_t)(byte(reader) << 8 | low);
}

static uint32_t number(trace_reader_t *reader)
{
    const uint32_t low = word(reader);
    return (uint32_t)word(reader) << 16 | low;
}

bool trace_reader_open(trace_reader_t *reader, trace_fetch_t fetch)
{
    reader->fetch = fetch;
    reader->at = 0;
    const uint32_t name = number(reader);
    reader->check_every = number(reader);
    reader->print_first = number(reader);
    reader->print_last = number(reader);
    return name == TRACE_NAME;
}

bool trace_reader_next(trace_reader_t *reader, trace_call_t *call)
{
    call->call = (call_t)byte(reader);
    call->axis = byte(reader);
    call->size = byte(reader);
    if (call->call == CALL_END || call->size > EXCHANGE_IN_MAX) {
        return false;
    }
    for (uint16_t i = 0; i < call->size; i++) {
        call->in[i] = word(reader);
    }
    return true;
}
