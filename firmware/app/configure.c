#include "app/configure.h"

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
        const bool wide = (axis_member_kind(k) & MEMBER_WIDE) != 0U;
        crc = crc32_add(crc, (uint32_t)axis_member_get(block, k), wide ? 4U : 2U);
    }
    return crc32_end(crc);
}

/* Index of the first member that differs and may only change at rest; AXIS_MEMBERS if there is none. */
static uint16_t rest_difference(const axis_config_t *block, const axis_config_t *other)
{
    uint16_t k = 0;
    while (k < AXIS_MEMBERS &&
           ((axis_member_kind(k) & MEMBER_LIVE) != 0U || axis_member_get(block, k) == axis_member_get(other, k))) {
        k++;
    }
    return k;
}

/* ---- requests of the host ------------------------------------------------------------------------------------------- */

static axis_config_t *spare(configure_t *configure, uint16_t axis)
{
    return &configure->block[axis][1U - configure->in_force[axis]];
}

/* Is `axis` in the set `axes` (bit 0 = axis 0)? */
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
        return CONFIG_REFUSAL_NONE; /* show the block in force */
    }
    if (holds(configure->pending, axis)) {
        return CONFIG_REFUSAL_BUSY;
    }
    for (uint16_t k = 0; k < count; k++) {
        const uint16_t number = (uint16_t)(first + k);
        if (!axis_member_accepts(number, get_word(data, (uint16_t)(CONFIG_VALUES + k)))) {
            status->refused_member = number;
            return CONFIG_REFUSAL_RANGE;
        }
    }
    configure->ready[axis] = false;
    for (uint16_t k = 0; k < count; k++) {
        const int32_t value = get_word(data, (uint16_t)(CONFIG_VALUES + k));
        axis_member_set(spare(configure, (uint16_t)axis), (uint16_t)(first + k), value);
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
        request->window[CONFIG_VALUES + k] = axis_member_get(block, (uint16_t)(first + k));
    }
}

/* ---- latching ------------------------------------------------------------------------------------------------------- */

void configure_init(configure_t *configure, config_status_t *status)
{
    *configure = (configure_t){0};
    *status = (config_status_t){.layout = AXIS_LAYOUT};
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        configure->block[i][0] = servo_config.axis[i];
    }
}

void configure_begin(configure_t *configure, config_status_t *status)
{
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        *spare(configure, i) = *configure_block(configure, i);
        status->checksum[i] = checksum(configure_block(configure, i), i);
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

/* A parameter follows its default when the default changes. */
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
                     nominal_block_t *nominal, axis_t *axes)
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
        nominal->torque_constant[i] = after->torque_constant;
        nominal->acceleration_current[i] = after->acceleration_forward;
        configure->in_force[i] = (uint16_t)(1U - configure->in_force[i]);
        configure->ready[i] = false;
        status->checksum[i] = configure->checksum[i];
    }
    configure->pending = 0;
    status->answers++;
    return taken;
}
