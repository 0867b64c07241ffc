#include "trace_writer.h"

#include <stdlib.h>

static void byte(trace_writer_t *writer, uint8_t value)
{
    if (writer->size == writer->room) {
        const size_t room = 2 * writer->room + 4096;
        uint8_t *bytes = (uint8_t *)realloc(writer->bytes, room);
        if (bytes == NULL) {
            writer->failed = true;
            return;
        }
        writer->bytes = bytes;
        writer->room = room;
    }
    writer->bytes[writer->size++] = value;
}

static void number(trace_writer_t *writer, uint32_t value)
{
    for (unsigned shift = 0; shift < 32U; shift += 8U) {
        byte(writer, (uint8_t)(value >> shift));
    }
}

static void field(trace_writer_t *writer, uint16_t value, unsigned size)
{
    while (size-- > 0U) {
        writer->pending = (uint8_t)(writer->pending << 1 | (value >> size & 1U));
        if (++writer->bits == 8U) {
            byte(writer, writer->pending);
            writer->bits = 0;
        }
    }
}

static void difference(trace_writer_t *writer, const trace_word_t *model, uint16_t value)
{
    const uint16_t distance = (uint16_t)(value - trace_word_prediction(model));
    const uint16_t twice = (uint16_t)(distance << 1);
    const uint16_t folded = (distance & 0x8000U) != 0U ? (uint16_t)~twice : twice;
    const uint16_t parameter = trace_word_parameter(model);
    const unsigned ones = (unsigned)folded >> parameter;
    for (unsigned i = 0; i < ones && i < TRACE_ESCAPE; i++) {
        field(writer, 1, 1);
    }
    if (ones < TRACE_ESCAPE) {
        field(writer, 0, 1);
        field(writer, folded, parameter);
    } else {
        field(writer, folded, 16);
    }
}

static void words(trace_writer_t *writer, trace_word_t *model, const trace_call_t *call)
{
    bool quiet = false;
    bool calm = true;
    for (uint16_t i = 0; i < call->size; i++) {
        if (trace_word_quiet(&model[i])) {
            quiet = true;
            calm = calm && call->in[i] == trace_word_prediction(&model[i]);
        }
    }
    if (quiet) {
        field(writer, calm ? 0 : 1, 1);
    }
    for (uint16_t i = 0; i < call->size; i++) {
        if (!calm || !trace_word_quiet(&model[i])) {
            difference(writer, &model[i], call->in[i]);
        }
        trace_word_learn(&model[i], call->in[i]);
    }
}

static uint16_t find(const trace_model_t *model, const trace_call_t *call)
{
    uint16_t i = 0;
    while (i < model->shapes && (model->shape[i].call != call->call || model->shape[i].axis != call->axis ||
                                 model->shape[i].size != call->size)) {
        i++;
    }
    return i;
}

static void shape(trace_writer_t *writer, const trace_call_t *call)
{
    trace_model_t *model = &writer->model;
    trace_shape_t *before = &model->shape[model->current];
    const uint16_t index = find(model, call);
    const bool known = index < model->shapes;
    if (known && index == before->successor) {
        field(writer, 0, 1);
    } else {
        field(writer, 1, 1);
        field(writer, index, TRACE_SHAPE_BITS);
    }
    if (!known) {
        field(writer, (uint16_t)call->call, 4);
        field(writer, call->axis, 4);
        field(writer, call->size, 8);
        if (!trace_model_add(model, (uint8_t)call->call, (uint8_t)call->axis, (uint8_t)call->size)) {
            writer->failed = true;
            return;
        }
    }
    before->successor = (uint8_t)index;
    model->current = index;
}

void trace_writer_open(trace_writer_t *writer, uint32_t check_every)
{
    writer->bytes = NULL;
    writer->size = writer->room = 0;
    writer->pending = 0;
    writer->bits = 0;
    writer->failed = false;
    trace_model_init(&writer->model);
    number(writer, UINT32_C(0x54565253));
    number(writer, check_every);
    number(writer, UINT32_MAX); /* print nothing */
    number(writer, 0);
}

void trace_writer_put(trace_writer_t *writer, const trace_call_t *call)
{
    if (writer->failed) {
        return;
    }
    shape(writer, call);
    if (!writer->failed) {
        words(writer, &writer->model.word[writer->model.shape[writer->model.current].first], call);
    }
}

void trace_writer_close(trace_writer_t *writer)
{
    const trace_call_t end = {.call = CALL_END};
    trace_writer_put(writer, &end);
    field(writer, 0, 7); /* complete the last byte */
}

void trace_writer_free(trace_writer_t *writer)
{
    free(writer->bytes);
    writer->bytes = NULL;
    writer->size = writer->room = 0;
}
