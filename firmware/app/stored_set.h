/* stored_set.h - format of a stored set of parameters and configuration in the data flash, 32-bit words.
 *
 *   0  STORED_FORMAT
 *   1  number of words of the set, with the checksum
 *   2  sequence number; the set with the higher one is newer
 *   3  STORED_LAYOUT: names and formats of all numbers, without their ranges
 *   4  all elements of all parameters, in the order of servo_ranges
 *      all members of the configuration block of axis 1, then of axis 2
 *      checksum: CRC-32 of all words before
 *
 * Length, sequence number and checksum have this place in every format: a set of another one is recognised.
 *
 * Each 16-bit number has its own word, because words are programmed one by one. The checksum is written last: a set is
 * complete or invalid.
 */
#ifndef SERVO_APP_STORED_SET_H
#define SERVO_APP_STORED_SET_H

#include "app/config_blocks.h"
#include "config/axis_layout_gen.h"
#include "config/contract_gen.h"

#define STORED_FORMAT UINT32_C(0x32535653)

#define STORED_HEAD 4U /* words before the first number */
#define STORED_NUMBERS (PARAMETER_VALUES + HAL_AXES * AXIS_MEMBERS)
#define STORED_CHECKSUM (STORED_HEAD + STORED_NUMBERS)
#define STORED_WORDS (STORED_CHECKSUM + 1U)

#define STORED_SECTORS (HAL_FLASH_SECTORS / STORAGE_COPIES) /* sectors per copy */
#define STORED_ROOM (STORED_SECTORS * HAL_FLASH_SECTOR_WORDS)

/* Values of a board. */
typedef struct {
    uint8_t *memory; /* memory shared with the host */
    uint16_t parameter; /* offset of the parameter block in `memory`, bytes */
    config_blocks_t *config_blocks;
} stored_values_t;

/* Word `index` of a set of the present values, except the checksum. */
uint32_t stored_word(const stored_values_t *values, uint32_t sequence, uint16_t index);

/* State of a copy in the flash, and its sequence number; 0: none. */
stored_copy_t stored_check(hal_t *hal, uint16_t copy, const stored_values_t *values, uint32_t *sequence);

/* Load a valid copy. */
void stored_load(hal_t *hal, uint16_t copy, const stored_values_t *values);

/* Flash address of word `index` of a copy, in words. */
static inline uint16_t stored_place(uint16_t copy, uint16_t index) { return (uint16_t)(copy * STORED_ROOM + index); }

#endif
