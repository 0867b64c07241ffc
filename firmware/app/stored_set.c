#include "app/stored_set.h"

#include <string.h>

#include "app/ranges.h"
#include "config/axis_members.h"
#include "math/crc32.h"

typedef char stored_set_fits_t[(STORED_WORDS <= STORED_ROOM) ? 1 : -1];

/* Words of the head of a set. */
enum { WORD_FORMAT, WORD_LENGTH, WORD_SEQUENCE, WORD_PARAMETER_LAYOUT, WORD_AXIS_LAYOUT };

/* ---- values by index ------------------------------------------------------------------------------------------------ */

typedef struct {
    variable_range_t range;
    uint16_t offset; /* offset of the element */
} parameter_element_t;

/* Element `number`, counted through the elements of all parameters. `number` must be below PARAMETER_VALUES: the search
 * ends at the element, not at the end of servo_ranges. */
static parameter_element_t element_of(const stored_values_t *values, uint16_t number)
{
    uint16_t i = 0;
    for (;; i++) {
        const variable_range_t *range = &servo_ranges[i];
        if (range->offset < values->parameter || range->offset >= values->parameter + sizeof(parameter_block_t)) {
            continue;
        }
        if (number < range->count) {
            return (parameter_element_t){*range, (uint16_t)(range->offset + number * range->size)};
        }
        number = (uint16_t)(number - range->count);
    }
}

static bool is_parameter(uint16_t index) { return index < STORED_HEAD + PARAMETER_VALUES; }

static uint16_t axis_of(uint16_t index) { return (uint16_t)((index - STORED_HEAD - PARAMETER_VALUES) / AXIS_MEMBERS); }

static uint16_t member_of(uint16_t index)
{
    return (uint16_t)((index - STORED_HEAD - PARAMETER_VALUES) % AXIS_MEMBERS);
}

static uint32_t value_of(const stored_values_t *values, uint16_t index)
{
    if (!is_parameter(index)) {
        return (uint32_t)axis_member_get(config_blocks_in_force(values->config_blocks, axis_of(index)),
                                         member_of(index));
    }
    const parameter_element_t element = element_of(values, (uint16_t)(index - STORED_HEAD));
    return ranges_get(&element.range, values->memory + element.offset);
}

static void set_value(const stored_values_t *values, uint16_t index, uint32_t value)
{
    if (!is_parameter(index)) {
        axis_member_set(config_blocks_writable(values->config_blocks, axis_of(index)), member_of(index),
                        (int32_t)value);
        return;
    }
    const parameter_element_t element = element_of(values, (uint16_t)(index - STORED_HEAD));
    ranges_set(&element.range, values->memory + element.offset, value);
}

/* True if the value is within the writable range of its variable. */
static bool accepts(const stored_values_t *values, uint16_t index, uint32_t value)
{
    if (!is_parameter(index)) {
        return axis_member_accepts(member_of(index), (int32_t)value);
    }
    const parameter_element_t element = element_of(values, (uint16_t)(index - STORED_HEAD));
    return ranges_accept_value(&element.range, value);
}

uint32_t stored_word(const stored_values_t *values, uint32_t sequence, uint16_t index)
{
    switch (index) {
    case WORD_FORMAT:
        return STORED_FORMAT;
    case WORD_LENGTH:
        return STORED_WORDS;
    case WORD_SEQUENCE:
        return sequence;
    case WORD_PARAMETER_LAYOUT:
        return PARAMETER_LAYOUT;
    case WORD_AXIS_LAYOUT:
        return AXIS_LAYOUT;
    default:
        return value_of(values, index);
    }
}

/* ---- a copy in the flash -------------------------------------------------------------------------------------------- */

static uint32_t read_word(hal_t *hal, uint16_t copy, uint16_t index)
{
    return hal_flash_read(hal, stored_place(copy, index));
}

static bool is_erased(hal_t *hal, uint16_t copy)
{
    uint16_t i = 0;
    while (i < STORED_ROOM && read_word(hal, copy, i) == HAL_FLASH_ERASED) {
        i++;
    }
    return i == STORED_ROOM;
}

/* True if the checksum of the copy is valid, for any layout. */
static bool is_sealed(hal_t *hal, uint16_t copy)
{
    const uint32_t length = read_word(hal, copy, WORD_LENGTH);
    if (read_word(hal, copy, WORD_FORMAT) != STORED_FORMAT || length <= STORED_HEAD || length > STORED_ROOM) {
        return false;
    }
    uint32_t crc = CRC32_START;
    for (uint16_t i = 0; i < length - 1U; i++) {
        crc = crc32_add(crc, read_word(hal, copy, i), 4);
    }
    return read_word(hal, copy, (uint16_t)(length - 1U)) == crc32_end(crc);
}

stored_copy_t stored_check(hal_t *hal, uint16_t copy, const stored_values_t *values, uint32_t *sequence)
{
    *sequence = 0;
    if (!is_sealed(hal, copy)) {
        return is_erased(hal, copy) ? STORED_COPY_EMPTY : STORED_COPY_DAMAGED;
    }
    *sequence = read_word(hal, copy, WORD_SEQUENCE);
    if (read_word(hal, copy, WORD_LENGTH) != STORED_WORDS ||
        read_word(hal, copy, WORD_PARAMETER_LAYOUT) != PARAMETER_LAYOUT ||
        read_word(hal, copy, WORD_AXIS_LAYOUT) != AXIS_LAYOUT) {
        return STORED_COPY_OTHER_LAYOUT;
    }
    for (uint16_t i = STORED_HEAD; i < STORED_CHECKSUM; i++) {
        if (!accepts(values, i, read_word(hal, copy, i))) {
            return STORED_COPY_OUT_OF_RANGE;
        }
    }
    return STORED_COPY_INTACT;
}

void stored_load(hal_t *hal, uint16_t copy, const stored_values_t *values)
{
    for (uint16_t i = STORED_HEAD; i < STORED_CHECKSUM; i++) {
        set_value(values, i, read_word(hal, copy, i));
    }
}
