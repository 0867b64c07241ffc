#include "app/configure.h"

#include <stddef.h>

#include "app/words.h"
#include "comm/table_memory.h"
#include "config/axis_members.h"
#include "drive/take_config.h"

/* ---- members as numbers --------------------------------------------------------------------------------------------- */

static axis_member_t member_at(uint16_t number)
{
    axis_member_t member;
    table_copy(&member, &axis_members[number], sizeof member);
    return member;
}

static axis_range_t range_of(uint16_t number)
{
    axis_range_t range;
    table_copy(&range, &axis_ranges[member_at(number).range], sizeof range);
    return range;
}

static int32_t member_get(const axis_config_t *block, uint16_t number)
{
    const void *member = (const uint8_t *)block + member_at(number).offset;
    const uint16_t kind = range_of(number).kind;
    if ((kind & MEMBER_WIDE) != 0U) {
        return (kind & MEMBER_SIGNED) != 0U ? *(const int32_t *)member : (int32_t)(*(const uint32_t *)member);
    }
    return (kind & MEMBER_SIGNED) != 0U ? *(const int16_t *)member : (int32_t)(*(const uint16_t *)member);
}

static void member_set(axis_config_t *block, uint16_t number, int32_t value)
{
    void *member = (uint8_t *)block + member_at(number).offset;
    const uint16_t kind = range_of(number).kind;
    if ((kind & MEMBER_WIDE) != 0U) {
        if ((kind & MEMBER_SIGNED) != 0U) {
            *(int32_t *)member = value;
        } else {
            *(uint32_t *)member = (uint32_t)value;
        }
    } else if ((kind & MEMBER_SIGNED) != 0U) {
        *(int16_t *)member = (int16_t)value;
    } else {
        *(uint16_t *)member = (uint16_t)value;
    }
}

static bool member_accepts(uint16_t number, int32_t value)
{
    const axis_range_t range = range_of(number);
    const bool bits = (range.kind & MEMBER_BITS) == 0U || ((uint32_t)value & ~(uint32_t)range.max) == 0U;
    return value >= range.min && value <= range.max && bits;
}

/* ---- a part of a block, and the host's words ------------------------------------------------------------------------ */

static int32_t get_word(const uint8_t *data, uint16_t word) { return (int32_t)word_at(data + (size_t)(4U * word)); }

/* ---- the sum of a block --------------------------------------------------------------------------------------------- */

#define CRC_START UINT32_C(0xFFFFFFFF)

/* CRC-32 as in zlib, four bits at a time: reflected, polynomial 04C11DB7h. */
static uint32_t crc_bytes(uint32_t crc, uint32_t value, uint16_t size)
{
    static const uint32_t steps[16] TABLE_MEMORY = {
        UINT32_C(0x00000000), UINT32_C(0x1DB71064), UINT32_C(0x3B6E20C8), UINT32_C(0x26D930AC),
        UINT32_C(0x76DC4190), UINT32_C(0x6B6B51F4), UINT32_C(0x4DB26158), UINT32_C(0x5005713C),
        UINT32_C(0xEDB88320), UINT32_C(0xF00F9344), UINT32_C(0xD6D6A3E8), UINT32_C(0xCB61B38C),
        UINT32_C(0x9B64C2B0), UINT32_C(0x86D3D2D4), UINT32_C(0xA00AE278), UINT32_C(0xBDBDF21C),
    };
    for (uint16_t k = 0; k < 2U * size; k++) {
        uint32_t step;
        table_copy(&step, &steps[(crc ^ value) & 0xFU], sizeof step);
        crc = (crc >> 4) ^ step;
        value >>= 4;
    }
    return crc;
}

static uint32_t checksum(const axis_config_t *block, uint16_t axis)
{
    uint32_t crc = crc_bytes(CRC_START, AXIS_LAYOUT, 4);
    crc = crc_bytes(crc, AXIS_MEMBERS, 4);
    crc = crc_bytes(crc, axis, 4);
    for (uint16_t k = 0; k < AXIS_MEMBERS; k++) {
        const bool wide = (range_of(k).kind & MEMBER_WIDE) != 0U;
        crc = crc_bytes(crc, (uint32_t)member_get(block, k), wide ? 4U : 2U);
    }
    return crc ^ CRC_START;
}

/* First member that differs and may only change at rest; AXIS_MEMBERS: there is none. */
static uint16_t rest_difference(const axis_config_t *block, const axis_config_t *other)
{
    uint16_t k = 0;
    while (k < AXIS_MEMBERS &&
           ((range_of(k).kind & MEMBER_LIVE) != 0U || member_get(block, k) == member_get(other, k))) {
        k++;
    }
    return k;
}

/* ---- the host's requests -------------------------------------------------------------------------------------------- */

static axis_config_t *spare(configure_t *configure, uint16_t axis)
{
    return &configure->block[axis][1U - configure->in_force[axis]];
}

/* A set of axes, a bit each, holds this one. */
static bool holds(uint16_t axes, uint32_t axis) { return ((uint32_t)axes >> axis & 1U) != 0U; }

static uint16_t write_window(configure_t *configure, config_status_t *status, const uint8_t *data, uint16_t size)
{
    const uint32_t axis = (uint32_t)get_word(data, CONFIG_AXIS);
    const uint32_t first = (uint32_t)get_word(data, CONFIG_FIRST);
    const uint32_t count = (uint32_t)get_word(data, CONFIG_COUNT);
    if (axis >= HAL_AXES) {
        return CONFIG_REFUSAL_AXIS;
    }
    if (first >= AXIS_MEMBERS || count > CONFIG_TOGETHER || first + count > AXIS_MEMBERS) {
        return CONFIG_REFUSAL_MEMBER;
    }
    if (size != 4U * (CONFIG_VALUES + count)) {
        return CONFIG_REFUSAL_FORM;
    }
    if (count == 0U) {
        return CONFIG_REFUSAL_NONE; /* shows what is in force */
    }
    if (holds(configure->pending, axis)) {
        return CONFIG_REFUSAL_BUSY;
    }
    for (uint16_t k = 0; k < count; k++) {
        const uint16_t number = (uint16_t)(first + k);
        if (!member_accepts(number, get_word(data, (uint16_t)(CONFIG_VALUES + k)))) {
            status->refused_member = number;
            return CONFIG_REFUSAL_RANGE;
        }
    }
    configure->ready[axis] = false;
    for (uint16_t k = 0; k < count; k++) {
        const int32_t value = get_word(data, (uint16_t)(CONFIG_VALUES + k));
        member_set(spare(configure, (uint16_t)axis), (uint16_t)(first + k), value);
    }
    return CONFIG_REFUSAL_NONE;
}

static uint16_t write_header(configure_t *configure, const uint8_t *data)
{
    const uint32_t axis = (uint32_t)get_word(data, 0);
    if (axis >= HAL_AXES) {
        return CONFIG_REFUSAL_AXIS;
    }
    if (holds(configure->pending, axis)) {
        return CONFIG_REFUSAL_BUSY;
    }
    configure->ready[axis] = false;
    if ((uint32_t)get_word(data, 1) != AXIS_LAYOUT) {
        return CONFIG_REFUSAL_LAYOUT;
    }
    if ((uint32_t)get_word(data, 2) != AXIS_MEMBERS) {
        return CONFIG_REFUSAL_LENGTH;
    }
    const axis_config_t *block = spare(configure, (uint16_t)axis);
    const uint32_t sum = checksum(block, (uint16_t)axis);
    if ((uint32_t)get_word(data, 3) != sum) {
        return CONFIG_REFUSAL_CHECKSUM;
    }
    configure->checksum[axis] = sum;
    configure->rest_member[axis] = rest_difference(block, configure_block(configure, (uint16_t)axis));
    configure->ready[axis] = true;
    return CONFIG_REFUSAL_NONE;
}

static uint16_t write_take(configure_t *configure, const uint8_t *data)
{
    const uint16_t axes = (uint16_t)(data[0] & 0xFFU);
    if (configure->pending != 0U) {
        return CONFIG_REFUSAL_BUSY;
    }
    if (axes == 0U || axes >> HAL_AXES != 0U || data[1] != 0U) {
        return CONFIG_REFUSAL_AXIS;
    }
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        if (holds(axes, i) && !configure->ready[i]) {
            return CONFIG_REFUSAL_UNCHECKED;
        }
    }
    configure->pending = axes;
    return CONFIG_REFUSAL_NONE;
}

bool configure_accept(configure_t *configure, config_status_t *status, uint16_t offset, bool whole, const uint8_t *data,
                      uint16_t size)
{
    uint16_t refusal = CONFIG_REFUSAL_FORM;
    if (whole && offset == offsetof(config_request_t, window) && size >= 4U * CONFIG_VALUES) {
        refusal = write_window(configure, status, data, size);
    } else if (whole && offset == offsetof(config_request_t, header) && size == 4U * CONFIG_HEADER) {
        refusal = write_header(configure, data);
    } else if (whole && offset == offsetof(config_request_t, take) && size == sizeof(uint16_t)) {
        refusal = write_take(configure, data);
    }
    status->refusal = refusal;
    return refusal == CONFIG_REFUSAL_NONE;
}

void configure_show(const configure_t *configure, config_request_t *request)
{
    if (request->window[CONFIG_COUNT] != 0) {
        return;
    }
    const axis_config_t *block = configure_block(configure, (uint16_t)request->window[CONFIG_AXIS]);
    const uint16_t first = (uint16_t)request->window[CONFIG_FIRST];
    for (uint16_t k = 0; k < CONFIG_TOGETHER && first + k < AXIS_MEMBERS; k++) {
        request->window[CONFIG_VALUES + k] = member_get(block, (uint16_t)(first + k));
    }
}

/* ---- taking --------------------------------------------------------------------------------------------------------- */

void configure_init(configure_t *configure, config_status_t *status)
{
    *configure = (configure_t){0};
    *status = (config_status_t){.layout = AXIS_LAYOUT};
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        configure->block[i][0] = servo_config.axis[i];
        configure->block[i][1] = servo_config.axis[i];
        status->checksum[i] = checksum(&configure->block[i][0], i);
    }
}

static bool may_take(const configure_t *configure, config_status_t *status, const axis_t *axes)
{
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        if (holds(configure->pending, i) && configure->rest_member[i] != AXIS_MEMBERS &&
            !axis_takes_any_config(&axes[i])) {
            status->refusal = CONFIG_REFUSAL_MOTION;
            status->refused_member = configure->rest_member[i];
            return false;
        }
    }
    return true;
}

/* Parameters whose default has changed get the new one. */
#define RENEW(parameter_element, member)                                                                               \
    do {                                                                                                               \
        if (before->member != after->member) {                                                                         \
            (parameter_element) = after->member;                                                                       \
        }                                                                                                              \
    } while (0)

static void renew_parameters(parameter_block_t *parameter, uint16_t i, const axis_config_t *before,
                             const axis_config_t *after)
{
    RENEW(parameter->speed_limit[i], speed_limit);
    RENEW(parameter->acceleration_limit[i], acceleration_limit);
    RENEW(parameter->i_q_limit[i], i_q_limit);
    RENEW(parameter->features[i], features);
    RENEW(parameter->feedback[i], feedback);
    RENEW(parameter->on_disable[i], stop.disable);
    RENEW(parameter->on_quick_stop[i], stop.quick_stop);
    RENEW(parameter->following_error[i], following_error);
    RENEW(parameter->over_speed[i], over_speed);
    if (before->position_limit != after->position_limit) {
        parameter->position_min[i] = -after->position_limit;
        parameter->position_max[i] = after->position_limit;
    }
}

bool configure_latch(configure_t *configure, config_status_t *status, parameter_block_t *parameter,
                     belief_block_t *belief, axis_t *axes)
{
    const bool taken = may_take(configure, status, axes);
    for (uint16_t i = 0; taken && i < HAL_AXES; i++) {
        if (!holds(configure->pending, i)) {
            continue;
        }
        const axis_config_t *before = configure_block(configure, i);
        const axis_config_t *after = spare(configure, i);
        axis_take_config(&axes[i], after);
        renew_parameters(parameter, i, before, after);
        belief->torque_constant[i] = after->torque_constant;
        belief->acceleration_current[i] = after->acceleration_forward;
        configure->in_force[i] = (uint16_t)(1U - configure->in_force[i]);
        configure->ready[i] = false;
        status->checksum[i] = configure->checksum[i];
    }
    configure->pending = 0;
    status->answers++;
    return taken;
}
