#include "app/config_blocks.h"

#include <stddef.h>

#include "app/words.h"
#include "config/axis_members.h"
#include "drive/take_config.h"
#include "math/crc32.h"

/* ---- access to the words of a block --------------------------------------------------------------------------------- */

static int32_t get_word(const uint8_t *data, uint16_t word) { return (int32_t)word_at(data + (size_t)(4U * word)); }

/* ---- checksum of a block -------------------------------------------------------------------------------------------- */

static uint32_t checksum(const axis_config_t *block, uint16_t axis)
{
    uint32_t crc = crc32_add(CRC32_START, AXIS_LAYOUT, 4);
    crc = crc32_add(crc, AXIS_MEMBERS, 4);
    crc = crc32_add(crc, axis, 4);
    for (uint16_t k = 0; k < AXIS_MEMBERS; k++) {
        crc = crc32_add(crc, (uint32_t)axis_member_get(block, k), number_size(axis_member_range(k).kind));
    }
    return crc32_end(crc);
}

/* Index of the first member that differs and may only change at rest; AXIS_MEMBERS if there is none. */
static uint16_t rest_difference(const axis_config_t *block, const axis_config_t *other)
{
    uint16_t k = 0;
    while (k < AXIS_MEMBERS && ((axis_member_range(k).kind & NUMBER_LIVE) != 0U ||
                                axis_member_get(block, k) == axis_member_get(other, k))) {
        k++;
    }
    return k;
}

/* ---- requests of the host ------------------------------------------------------------------------------------------- */

static axis_config_t *spare(config_blocks_t *blocks, uint16_t axis)
{
    return &blocks->block[axis][1U - blocks->in_force[axis]];
}

/* True if `axis` is in the set `axes` (bit 0: axis 0). */
static bool holds(uint16_t axes, uint32_t axis) { return ((uint32_t)axes >> axis & 1U) != 0U; }

static bool is_busy(const config_blocks_t *blocks, uint32_t axis)
{
    return holds(blocks->pending, axis) || holds(blocks->reserved, axis);
}

/* Mark the spare block as ready if its checksum, which follows the last member, is `sum`. */
static uint16_t write_checksum(config_blocks_t *blocks, uint16_t axis, uint32_t sum)
{
    const axis_config_t *block = spare(blocks, axis);
    if (checksum(block, axis) != sum) {
        return CONFIG_REFUSAL_CHECKSUM;
    }
    blocks->checksum[axis] = sum;
    blocks->rest_member[axis] = rest_difference(block, config_blocks_in_force(blocks, axis));
    blocks->ready[axis] = true;
    return CONFIG_REFUSAL_NONE;
}

static uint16_t write_window(config_blocks_t *blocks, config_status_t *status, const uint8_t *data, uint16_t size)
{
    const uint32_t axis = (uint32_t)get_word(data, CONFIG_AXIS);
    const uint32_t first = (uint32_t)get_word(data, CONFIG_FIRST);
    const uint32_t count = (uint32_t)get_word(data, CONFIG_COUNT);
    if (axis >= HAL_AXES) {
        return CONFIG_REFUSAL_AXIS;
    }
    if (first > AXIS_MEMBERS || count > CONFIG_TOGETHER || first + count > AXIS_MEMBERS + 1U) {
        return CONFIG_REFUSAL_MEMBER;
    }
    if (size != 4U * (CONFIG_VALUES + count)) {
        return CONFIG_REFUSAL_FORM;
    }
    if (count == 0U) {
        return CONFIG_REFUSAL_NONE; /* show the block in force */
    }
    if (is_busy(blocks, axis)) {
        return CONFIG_REFUSAL_BUSY;
    }
    const bool sealed = first + count > AXIS_MEMBERS;
    const uint16_t members = (uint16_t)(sealed ? count - 1U : count);
    for (uint16_t k = 0; k < members; k++) {
        const uint16_t number = (uint16_t)(first + k);
        const number_range_t range = axis_member_range(number);
        if (!number_accepts(&range, get_word(data, (uint16_t)(CONFIG_VALUES + k)))) {
            status->refused_member = number;
            return CONFIG_REFUSAL_RANGE;
        }
    }
    blocks->ready[axis] = false;
    for (uint16_t k = 0; k < members; k++) {
        const int32_t value = get_word(data, (uint16_t)(CONFIG_VALUES + k));
        axis_member_set(spare(blocks, (uint16_t)axis), (uint16_t)(first + k), value);
    }
    if (!sealed) {
        return CONFIG_REFUSAL_NONE;
    }
    return write_checksum(blocks, (uint16_t)axis, (uint32_t)get_word(data, (uint16_t)(CONFIG_VALUES + members)));
}

static uint16_t write_take(config_blocks_t *blocks, const uint8_t *data)
{
    const uint16_t axes = (uint16_t)(data[0] & 0xFFU);
    if (blocks->pending != 0U || (axes & blocks->reserved) != 0U) {
        return CONFIG_REFUSAL_BUSY;
    }
    if (axes == 0U || axes >> HAL_AXES != 0U || data[1] != 0U) {
        return CONFIG_REFUSAL_AXIS;
    }
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        if (holds(axes, i) && !blocks->ready[i]) {
            return CONFIG_REFUSAL_UNCHECKED;
        }
    }
    blocks->pending = axes;
    return CONFIG_REFUSAL_NONE;
}

bool config_blocks_accept(config_blocks_t *blocks, config_status_t *status, uint16_t offset, bool whole,
                          const uint8_t *data, uint16_t size)
{
    uint16_t refusal = CONFIG_REFUSAL_FORM;
    if (whole && offset == offsetof(config_request_t, window) && size >= 4U * CONFIG_VALUES) {
        refusal = write_window(blocks, status, data, size);
    } else if (whole && offset == offsetof(config_request_t, take) && size == sizeof(uint16_t)) {
        refusal = write_take(blocks, data);
    }
    status->refusal = refusal;
    return refusal == CONFIG_REFUSAL_NONE;
}

void config_blocks_show(const config_blocks_t *blocks, config_request_t *request)
{
    if (request->window[CONFIG_COUNT] != 0) {
        return;
    }
    const axis_config_t *block = config_blocks_in_force(blocks, (uint16_t)request->window[CONFIG_AXIS]);
    const uint16_t first = (uint16_t)request->window[CONFIG_FIRST];
    for (uint16_t k = 0; k < CONFIG_TOGETHER && first + k < AXIS_MEMBERS; k++) {
        request->window[CONFIG_VALUES + k] = axis_member_get(block, (uint16_t)(first + k));
    }
}

/* ---- kept block ----------------------------------------------------------------------------------------------------- */

static uint16_t next_axis(uint16_t axis) { return (uint16_t)((axis + 1U) % HAL_AXES); }

bool config_blocks_keep(config_blocks_t *blocks, uint16_t axis)
{
    const uint16_t keeper = next_axis(axis);
    if (blocks->pending != 0U) {
        return false;
    }
    *spare(blocks, keeper) = *config_blocks_in_force(blocks, axis);
    blocks->ready[keeper] = false;
    blocks->reserved = (uint16_t)(1U << keeper);
    return true;
}

void config_blocks_reserve(config_blocks_t *blocks) { blocks->reserved = (uint16_t)((1U << HAL_AXES) - 1U); }

void config_blocks_return(config_blocks_t *blocks, uint16_t axis, uint32_t sum)
{
    if (blocks->pending != 0U) {
        return;
    }
    *spare(blocks, axis) = *spare(blocks, next_axis(axis));
    blocks->checksum[axis] = sum;
    blocks->rest_member[axis] = 0; /* differs, as far as may_take is concerned */
    blocks->ready[axis] = true;
    blocks->pending = (uint16_t)(1U << axis);
}

void config_blocks_release(config_blocks_t *blocks) { blocks->reserved = 0; }

/* ---- latching ------------------------------------------------------------------------------------------------------- */

void config_blocks_init(config_blocks_t *blocks, config_status_t *status, const servo_config_t *config)
{
    *blocks = (config_blocks_t){0};
    *status = (config_status_t){.layout = AXIS_LAYOUT};
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        blocks->block[i][0] = config->axis[i];
    }
}

void config_blocks_begin(config_blocks_t *blocks, config_status_t *status)
{
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        *spare(blocks, i) = *config_blocks_in_force(blocks, i);
        status->checksum[i] = checksum(config_blocks_in_force(blocks, i), i);
    }
}

static bool may_take(const config_blocks_t *blocks, config_status_t *status, const axis_t *axes)
{
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        if (holds(blocks->pending, i) && blocks->rest_member[i] != AXIS_MEMBERS && !axis_takes_any_config(&axes[i])) {
            status->refusal = CONFIG_REFUSAL_MOTION;
            status->refused_member = blocks->rest_member[i];
            return false;
        }
    }
    return true;
}

bool config_blocks_latch(config_blocks_t *blocks, config_status_t *status, parameter_block_t *parameter,
                         nominal_block_t *nominal, axis_t *axes)
{
    const bool taken = may_take(blocks, status, axes);
    for (uint16_t i = 0; taken && i < HAL_AXES; i++) {
        if (!holds(blocks->pending, i)) {
            continue;
        }
        const axis_config_t *before = config_blocks_in_force(blocks, i);
        const axis_config_t *after = spare(blocks, i);
        axis_take_config(&axes[i], after);
        parameters_renew(parameter, i, before, after);
        nominal->torque_constant[i] = after->torque_constant;
        nominal->acceleration_current[i] = after->acceleration_forward;
        blocks->in_force[i] = (uint16_t)(1U - blocks->in_force[i]);
        blocks->ready[i] = false;
        status->checksum[i] = blocks->checksum[i];
    }
    blocks->pending = 0;
    status->answers++;
    return taken;
}
