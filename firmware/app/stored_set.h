/* stored_set.h - parameters and configuration as a row of words in the data flash.
 *
 *   0  STORED_FORMAT
 *   1  words of the set, with the seal
 *   2  sequence number: the higher one is newer
 *   3  PARAMETER_LAYOUT
 *   4  AXIS_LAYOUT
 *   5  every element of every parameter, in the order of servo_ranges
 *      every member of the block of axis 1, then of axis 2
 *      the seal: CRC-32 of all before
 *
 * A number of 16 bits has a word of its own: words are programmed one by one, and each is what it is without its
 * neighbours. The seal comes last. So a set is whole or none.
 */
#ifndef SERVO_APP_STORED_SET_H
#define SERVO_APP_STORED_SET_H

#include "app/config_blocks.h"
#include "config/axis_layout_gen.h"
#include "config/contract_gen.h"

#define STORED_FORMAT UINT32_C(0x31535653)

#define STORED_HEAD 5U
#define STORED_SEAL (STORED_HEAD + PARAMETER_VALUES + HAL_AXES * AXIS_MEMBERS)
#define STORED_WORDS (STORED_SEAL + 1U)

#define STORED_SECTORS (HAL_FLASH_SECTORS / STORAGE_COPIES) /* of a copy */
#define STORED_ROOM (STORED_SECTORS * HAL_FLASH_SECTOR_WORDS)

/* The values of a board. */
typedef struct {
    uint8_t *memory; /* shared with the host .. */
    uint16_t parameter; /* .. with the parameter block at this offset */
    config_blocks_t *config_blocks;
} stored_values_t;

/* Word `index` of a set of the present values, but for the seal. */
uint32_t stored_word(const stored_values_t *values, uint32_t sequence, uint16_t index);

/* What a copy in the flash is worth, and its sequence number; 0 if it has none. */
stored_copy_t stored_check(hal_t *hal, uint16_t copy, const stored_values_t *values, uint32_t *sequence);

/* Take over a copy that is intact. */
void stored_load(hal_t *hal, uint16_t copy, const stored_values_t *values);

/* Where word `index` of a copy lies in the flash. */
static inline uint16_t stored_place(uint16_t copy, uint16_t index) { return (uint16_t)(copy * STORED_ROOM + index); }

#endif
