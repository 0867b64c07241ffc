#include "app/ranges.h"

#include <stddef.h>

#include "config/contract_gen.h"

typedef struct {
    uint32_t begin; /* offset in the memory [bytes] */
    uint32_t end;
    const uint8_t *data;
    const uint8_t *mask; /* NULL: all bits are written */
} host_write_t;

/* Value of the `size` bytes at `offset` after the write, as an unsigned little-endian number. */
static uint32_t value_after(const ranges_memory_t *in, const host_write_t *write, uint16_t offset, uint16_t size)
{
    const uint8_t *memory = in->memory + offset;
    uint32_t value = 0;
    for (uint16_t k = 0; k < size; k++) {
        unsigned byte = memory[k];
        const uint32_t at = (uint32_t)offset + k;
        if (at >= write->begin && at < write->end) {
            const uint16_t i = (uint16_t)(at - write->begin);
            const unsigned select = (write->mask != NULL) ? write->mask[i] : 0xFFU;
            byte = (byte & ~select) | (write->data[i] & select);
        }
        value |= (uint32_t)(byte & 0xFFU) << (8U * k);
    }
    return value;
}

/* Positions wrap at 32 bits: the direction to a set-point 2^31 counts away is ambiguous, and would depend on the
 * residual movement of the shaft. */
static bool in_reach(const ranges_memory_t *in, uint16_t axis, uint32_t value)
{
    const uint32_t reach = (uint32_t)POSITION_REACH;
    return value - (uint32_t)in->snapshot->axis[axis].position + reach <= 2U * reach;
}

/* Features that the configuration of an axis has no constants for. */
static uint32_t impossible_features(const axis_t *axis)
{
    return (axis_observable(axis) ? 0U : FEATURE_ANGLE_CHECK) |
           (axis_has_speed_observer(axis) ? 0U : FEATURE_SPEED_OBSERVER);
}

/* Value of an element of a variable beyond its range, in the present state of the board. */
static bool is_possible(const ranges_memory_t *in, uint16_t variable, uint16_t axis, uint32_t value)
{
    if (variable == in->positions) {
        return in_reach(in, axis, value);
    }
    if (variable == in->features) {
        return (value & impossible_features(&in->axes[axis])) == 0U;
    }
    return variable != in->feedbacks || value != FEEDBACK_KIND_OBSERVER || axis_observable(&in->axes[axis]);
}

static bool elements_accept(const ranges_memory_t *in, const variable_range_t *variable, const host_write_t *write)
{
    const uint16_t size = number_size(variable->range.kind);
    for (uint16_t i = 0; i < variable->count; i++) {
        const uint16_t offset = (uint16_t)(variable->offset + i * size);
        if (offset >= write->end || (uint32_t)offset + size <= write->begin) {
            continue; /* not part of the write */
        }
        const uint32_t value = value_after(in, write, offset, size);
        if (!number_accepts(&variable->range, number_of(value, variable->range.kind)) ||
            !is_possible(in, variable->offset, i, value)) {
            return false;
        }
    }
    return true;
}

bool ranges_accept(const ranges_memory_t *in, uint16_t offset, const uint8_t *data, const uint8_t *mask, uint16_t size)
{
    const host_write_t write = {offset, (uint32_t)offset + size, data, mask};
    for (uint16_t i = 0; i < servo_ranges_count; i++) {
        if (!elements_accept(in, &servo_ranges[i], &write)) {
            return false;
        }
    }
    return true;
}
