#include "app/stored_set.h"

#include "app/variables.h"
#include "config/axis_members.h"
#include "math/crc32.h"

typedef char stored_set_fits_t[(STORED_WORDS <= STORED_ROOM) ? 1 : -1];

/* Words of the head of a set. */
enum { WORD_FORMAT, WORD_LENGTH, WORD_SEQUENCE, WORD_LAYOUT };

/* ---- numbers of a set ----------------------------------------------------------------------------------------------- */

/* Element `number`, counted through the elements of all parameters. `number` must be below PARAMETER_VALUES: the search
 * ends at the element, not at the end of servo_ranges. */
static number_t parameter_at(const stored_values_t *values, uint16_t number)
{
    for (uint16_t i = 0;; i++) {
        const variable_range_t *variable = &servo_ranges[i];
        if (variable->offset < values->parameter || variable->offset >= values->parameter + sizeof(parameter_block_t)) {
            continue;
        }
        if (number < variable->count) {
            const uint16_t offset = (uint16_t)(variable->offset + number * number_size(variable->range.kind));
            return (number_t){values->memory + offset, variable->range};
        }
        number = (uint16_t)(number - variable->count);
    }
}

/* Number `index` of a set: first all parameters, then the members of each axis. */
static number_t number_at(const stored_values_t *values, uint16_t index)
{
    if (index < PARAMETER_VALUES) {
        return parameter_at(values, index);
    }
    const uint16_t member = (uint16_t)(index - PARAMETER_VALUES);
    axis_config_t *block = config_blocks_writable(values->config_blocks, (uint16_t)(member / AXIS_MEMBERS));
    return axis_member(block, (uint16_t)(member % AXIS_MEMBERS));
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
    case WORD_LAYOUT:
        return STORED_LAYOUT;
    default: {
        const number_t number = number_at(values, (uint16_t)(index - STORED_HEAD));
        return (uint32_t)number_get(number.at, number.range.kind);
    }
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

/* True if the checksum of the copy is valid, for any format and layout. */
static bool is_sealed(hal_t *hal, uint16_t copy)
{
    const uint32_t length = read_word(hal, copy, WORD_LENGTH);
    if (length <= STORED_HEAD || length > STORED_ROOM) {
        return false;
    }
    uint32_t crc = CRC32_START;
    for (uint16_t i = 0; i < length - 1U; i++) {
        crc = crc32_add(crc, read_word(hal, copy, i), 4);
    }
    return read_word(hal, copy, (uint16_t)(length - 1U)) == crc32_end(crc);
}

static bool has_layout(hal_t *hal, uint16_t copy)
{
    return read_word(hal, copy, WORD_FORMAT) == STORED_FORMAT && read_word(hal, copy, WORD_LAYOUT) == STORED_LAYOUT &&
           read_word(hal, copy, WORD_LENGTH) == STORED_WORDS;
}

stored_copy_t stored_check(hal_t *hal, uint16_t copy, const stored_values_t *values, uint32_t *sequence)
{
    *sequence = 0;
    if (!is_sealed(hal, copy)) {
        return is_erased(hal, copy) ? STORED_COPY_EMPTY : STORED_COPY_DAMAGED;
    }
    *sequence = read_word(hal, copy, WORD_SEQUENCE);
    if (!has_layout(hal, copy)) {
        return STORED_COPY_OTHER_LAYOUT;
    }
    for (uint16_t i = 0; i < STORED_NUMBERS; i++) {
        const number_t number = number_at(values, i);
        if (!number_accepts(&number.range, (int32_t)read_word(hal, copy, (uint16_t)(STORED_HEAD + i)))) {
            return STORED_COPY_OUT_OF_RANGE;
        }
    }
    return STORED_COPY_INTACT;
}

void stored_load(hal_t *hal, uint16_t copy, const stored_values_t *values)
{
    for (uint16_t i = 0; i < STORED_NUMBERS; i++) {
        const number_t number = number_at(values, i);
        number_set(number.at, number.range.kind, (int32_t)read_word(hal, copy, (uint16_t)(STORED_HEAD + i)));
    }
}
