/* recorder_take.c - what a recorder does in its loop. */
#include <stddef.h>

#include "comm/cell.h"
#include "comm/recorder.h"

static uint32_t number_at(const uint8_t *at, uint8_t size, uint8_t cell)
{
    if (size == 2 && cell == 2) {
        return *(const cell2_t *)(const void *)at;
    }
    if (size == 4 && cell == 4) {
        return *(const cell4_t *)(const void *)at;
    }
    uint32_t number = 0;
    for (uint16_t k = 0; k < size; k++) {
        number |= (uint32_t)at[k] << (8u * k);
    }
    return number;
}

/* Value of a variable of 8 bytes against its threshold. */
static bool wide_reached(const recorder_slot_t *slot)
{
    const uint32_t lower = number_at(slot->source, 4, slot->cell);
    const uint32_t upper = number_at(slot->source + 4, 4, slot->cell) ^ slot->bias;
    uint32_t limit_lower = slot->threshold;
    uint32_t limit_upper = slot->threshold_upper;
    if (slot->limit != NULL) {
        limit_lower = number_at(slot->limit, 4, slot->cell);
        limit_upper = number_at(slot->limit + 4, 4, slot->cell) ^ slot->bias;
    }
    return upper > limit_upper || (upper == limit_upper && lower >= limit_lower);
}

static bool reached(const recorder_slot_t *slot)
{
    if (slot->size > 4) {
        return wide_reached(slot);
    }
    const uint32_t value = number_at(slot->source, slot->size, slot->cell) ^ slot->bias;
    if (slot->limit == NULL) {
        return value >= slot->threshold;
    }
    return value >= (number_at(slot->limit, slot->size, slot->cell) ^ slot->bias);
}

static bool fires(const recorder_slot_t *slot, bool above)
{
    if ((slot->mode & (above ? RECORDER_MODE_ABOVE : RECORDER_MODE_BELOW)) == 0) {
        return false;
    }
    return (slot->mode & RECORDER_MODE_LEVEL) != 0 || slot->above != above;
}

/* Nothing fires before the memory is full for the first time. */
static void judge(recorder_sampling_t *sampling)
{
    for (uint16_t k = 0; k < sampling->triggers; k++) {
        recorder_slot_t *slot = sampling->trigger[k];
        const bool above = reached(slot);
        if (sampling->filled && !sampling->stopping && fires(slot, above)) {
            sampling->stopping = true;
            sampling->left = sampling->after;
        }
        slot->above = above;
    }
}

static void store(const recorder_sampling_t *sampling, uint8_t *to)
{
    const uint8_t *const *from = sampling->source;
    const uint8_t *const *end = from + sampling->moves;
    if (sampling->cell == 2) {
        cell2_t *cell = (cell2_t *)(void *)to;
        do {
            *cell++ = *(const cell2_t *)(const void *)*from++;
        } while (from != end);
    } else if (sampling->cell == 4) {
        cell4_t *cell = (cell4_t *)(void *)to;
        do {
            *cell++ = *(const cell4_t *)(const void *)*from++;
        } while (from != end);
    } else {
        do {
            *to++ = **from++;
        } while (from != end);
    }
}

void recorder_take(recorder_t *recorder)
{
    recorder_sampling_t *sampling = &recorder->sampling;
    if (sampling->skip != 0) {
        sampling->skip--;
        return;
    }
    sampling->skip = sampling->divider;
    if (sampling->triggers != 0) {
        judge(sampling);
    }
    uint16_t at = sampling->at;
    store(sampling, (uint8_t *)recorder->app.samples + at);
    at = (uint16_t)(at + sampling->point);
    if (at == sampling->end) {
        at = 0;
        sampling->filled = true;
    }
    sampling->at = at;
    if (sampling->stopping) {
        if (sampling->left == 0) {
            sampling->running = false;
        } else {
            sampling->left--;
        }
    }
}
