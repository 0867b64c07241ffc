/* recorder_take.c - sampling of a recorder inside a control loop, optimised for speed, above all without triggers. */
#include <stddef.h>

#include "comm/cell.h"
#include "comm/recorder.h"

#if defined(__GNUC__)
#define NOINLINE __attribute__((noinline))
#else
#define NOINLINE
#endif

static uint32_t number_at(const uint8_t *at, uint8_t size)
{
    uint32_t number = 0;
    for (uint16_t k = 0; k < size; k++) {
        number |= (uint32_t)at[k] << (8u * k);
    }
    return number;
}

/* is_above for the other cases: values that are not aligned or have 1 or 8 bytes, and thresholds that are variables. */
static NOINLINE bool is_above_general(const recorder_slot_t *slot)
{
    const bool wide = slot->size > 4;
    const uint8_t size = wide ? 4 : slot->size;
    uint32_t value = number_at(slot->source, size);
    uint32_t threshold = slot->limit != NULL ? number_at(slot->limit, size) : slot->threshold;
    if (wide) {
        const uint32_t upper = number_at(slot->source + 4, 4) ^ slot->bias;
        const uint32_t limit = slot->limit != NULL ? number_at(slot->limit + 4, 4) ^ slot->bias : slot->threshold_upper;
        return upper > limit || (upper == limit && value >= threshold);
    }
    value ^= slot->bias;
    threshold ^= slot->limit != NULL ? slot->bias : 0;
    return value >= threshold;
}

/* True if the variable is at or above its threshold. */
static bool is_above(const recorder_slot_t *slot)
{
    const void *source = slot->source;
    if (slot->direct == 2) {
        return (*(const cell2_t *)source ^ slot->bias) >= slot->threshold;
    }
    if (slot->direct == 4) {
        return (*(const cell4_t *)source ^ slot->bias) >= slot->threshold;
    }
    return is_above_general(slot);
}

/* Stop a number of points after a trigger. No trigger before the memory has been filled once. */
static void check_triggers(recorder_sampling_t *sampling)
{
    recorder_slot_t *const *trigger = sampling->trigger;
    do {
        recorder_slot_t *slot = *trigger++;
        const bool above = is_above(slot);
        const bool edge = slot->above != above;
        slot->above = above;
        if (sampling->armed && (edge || (slot->mode & RECORDER_MODE_LEVEL) != 0) &&
            (slot->mode & (above ? RECORDER_MODE_ABOVE : RECORDER_MODE_BELOW)) != 0) {
            sampling->armed = false;
            sampling->stopping = true;
            sampling->remaining = sampling->after;
        }
    } while (trigger != sampling->trigger_end);
}

/* Fill the bytes from `to` up to `end`. */
static void store(const recorder_sampling_t *sampling, uint8_t *to, const uint8_t *end)
{
    const uint8_t *const *from = sampling->source;
    if (sampling->cell == 2) {
        cell2_t *cell = (cell2_t *)(void *)to;
        do {
            *cell++ = *(const cell2_t *)(const void *)*from++;
        } while (cell != (const cell2_t *)(const void *)end);
    } else if (sampling->cell == 4) {
        cell4_t *cell = (cell4_t *)(void *)to;
        do {
            *cell++ = *(const cell4_t *)(const void *)*from++;
        } while (cell != (const cell4_t *)(const void *)end);
    } else {
        do {
            *to++ = **from++;
        } while (to != end);
    }
}

void recorder_take(recorder_t *recorder)
{
    recorder_sampling_t *sampling = &recorder->memory->sampling;
    if (sampling->skip != 0) {
        sampling->skip--;
        return;
    }
    sampling->skip = sampling->divider;
    if (sampling->trigger_end != sampling->trigger) {
        check_triggers(sampling);
    }
    uint8_t *next = sampling->next + sampling->point;
    store(sampling, sampling->next, next);
    if (next == sampling->end) {
        next = (uint8_t *)recorder->memory->samples;
        sampling->armed = sampling->armed || !sampling->filled;
        sampling->filled = true;
    }
    sampling->next = next;
    if (sampling->stopping) {
        if (sampling->remaining == 0) {
            recorder->running = false;
        } else {
            sampling->remaining--;
        }
    }
}
