#include "trace.h"

static uint32_t number(trace_reader_t *reader)
{
    uint32_t value = 0;
    for (uint16_t shift = 0; shift < 32U; shift = (uint16_t)(shift + 8U)) {
        value |= (uint32_t)reader->fetch(reader->at) << shift;
        reader->at++;
    }
    return value;
}

bool trace_reader_open(trace_reader_t *reader, trace_fetch_t fetch)
{
    reader->fetch = fetch;
    reader->at = 0;
    reader->buffer = 0;
    reader->bits = 0;
    const uint32_t name = number(reader);
    reader->check_every = number(reader);
    reader->print_first = number(reader);
    reader->print_last = number(reader);
    trace_model_init(&reader->model);
    return name == UINT32_C(0x54565253);
}

static uint16_t bit(trace_reader_t *reader)
{
    if (reader->bits == 0U) {
        reader->buffer = reader->fetch(reader->at);
        reader->at++;
        reader->bits = 8;
    }
    reader->bits--;
    return (uint16_t)((uint16_t)(reader->buffer >> reader->bits) & 1U);
}

static uint16_t field(trace_reader_t *reader, uint16_t size)
{
    uint16_t value = 0;
    for (uint16_t i = 0; i < size; i++) {
        value = (uint16_t)((uint16_t)(value << 1) | bit(reader));
    }
    return value;
}

static uint16_t difference_of(trace_reader_t *reader, const trace_word_t *word)
{
    uint16_t ones = 0;
    while (ones < TRACE_ESCAPE && bit(reader) != 0U) {
        ones++;
    }
    uint16_t folded;
    if (ones == TRACE_ESCAPE) {
        folded = field(reader, 16);
    } else {
        const uint16_t parameter = trace_word_parameter(word);
        folded = (uint16_t)((uint16_t)(ones << parameter) | field(reader, parameter));
    }
    const uint16_t half = (uint16_t)(folded >> 1);
    return ((folded & 1U) != 0U) ? (uint16_t)~half : half;
}

static bool has_quiet(const trace_word_t *word, uint16_t size)
{
    for (uint16_t i = 0; i < size; i++) {
        if (trace_word_quiet(&word[i])) {
            return true;
        }
    }
    return false;
}

static void words_of(trace_reader_t *reader, trace_word_t *word, trace_call_t *call)
{
    const bool calm = has_quiet(word, call->size) && bit(reader) == 0U;
    for (uint16_t i = 0; i < call->size; i++) {
        uint16_t value = trace_word_prediction(&word[i]);
        if (!calm || !trace_word_quiet(&word[i])) {
            value = (uint16_t)(value + difference_of(reader, &word[i]));
        }
        trace_word_learn(&word[i], value);
        call->in[i] = value;
    }
}

static bool shape_of(trace_reader_t *reader)
{
    trace_model_t *model = &reader->model;
    trace_shape_t *before = &model->shape[model->current];
    uint16_t index = before->successor;
    if (bit(reader) != 0U) {
        index = field(reader, TRACE_SHAPE_BITS);
    }
    if (index == model->shapes) {
        const uint8_t call = (uint8_t)field(reader, 4);
        const uint8_t axis = (uint8_t)field(reader, 4);
        if (!trace_model_add(model, call, axis, (uint8_t)field(reader, 8))) {
            return false;
        }
    }
    if (index >= model->shapes) {
        return false;
    }
    before->successor = (uint8_t)index;
    model->current = index;
    return true;
}

bool trace_reader_next(trace_reader_t *reader, trace_call_t *call)
{
    trace_model_t *model = &reader->model;
    if (model->shape[model->current].call == CALL_END || !shape_of(reader)) {
        return false;
    }
    const trace_shape_t *shape = &model->shape[model->current];
    call->call = (call_t)shape->call;
    call->axis = shape->axis;
    call->size = shape->size;
    words_of(reader, &model->word[shape->first], call);
    return call->call != CALL_END;
}
