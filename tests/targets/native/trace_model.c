#include "trace.h"

#define ERROR_MAX 4095 /* eight times that still fits */

void trace_model_init(trace_model_t *model)
{
    model->shapes = 0;
    model->words = 0;
    model->current = 0;
    (void)trace_model_add(model, CALL_INIT, 0, 0); /* what the first call follows upon */
}

bool trace_model_add(trace_model_t *model, uint8_t call, uint8_t axis, uint8_t size)
{
    if (model->shapes >= TRACE_SHAPES || size > TRACE_WORDS - model->words || size > EXCHANGE_IN_MAX) {
        return false;
    }
    const trace_shape_t shape = {call, axis, size, TRACE_SUCCESSOR_NONE, model->words};
    const trace_word_t word = {0, 0, {0, 0}};
    model->shape[model->shapes] = shape;
    model->shapes++;
    for (uint16_t i = 0; i < size; i++) {
        model->word[model->words] = word;
        model->words++;
    }
    return true;
}

uint16_t trace_word_prediction(const trace_word_t *word)
{
    return (word->error[1] < word->error[0]) ? (uint16_t)(word->last + word->step) : word->last;
}

/* Errors have five significant bits, which saves memory on a small machine: up to 31 exact, then 1xxxx << e as
 * 16 (e + 1) + xxxx. */
static uint16_t wide(uint8_t error)
{
    return (uint16_t)((error < 16U) ? error : ((16U + (error & 15U)) << ((error >> 4) - 1U)));
}

static uint8_t narrow(uint16_t error)
{
    uint16_t exponent = 0;
    for (; error >= 32U; error >>= 1) {
        exponent++;
    }
    return (uint8_t)((error < 16U) ? error : 16U * exponent + error);
}

static uint16_t least_error(const trace_word_t *word)
{
    return wide((word->error[1] < word->error[0]) ? word->error[1] : word->error[0]);
}

bool trace_word_quiet(const trace_word_t *word) { return least_error(word) < 8U; }

uint16_t trace_word_parameter(const trace_word_t *word)
{
    const uint16_t error = least_error(word);
    uint16_t parameter = 0;
    while (parameter < 12U && (uint16_t)(UINT16_C(12) << parameter) <= error) {
        parameter++;
    }
    return parameter;
}

static void average(uint8_t *error, uint16_t value, uint16_t prediction)
{
    const uint16_t before = wide(*error);
    const uint16_t up = (uint16_t)(value - prediction);
    const uint16_t down = (uint16_t)(prediction - value);
    const uint16_t distance = (up < down) ? up : down;
    const uint16_t folded = (distance < ERROR_MAX / 2) ? (uint16_t)(2U * distance) : (uint16_t)ERROR_MAX;
    *error = narrow((uint16_t)(before - before / 8U + folded));
}

void trace_word_learn(trace_word_t *word, uint16_t value)
{
    average(&word->error[0], value, word->last);
    average(&word->error[1], value, (uint16_t)(word->last + word->step));
    word->step = (uint16_t)(value - word->last);
    word->last = value;
}
