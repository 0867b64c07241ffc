/* flash.h - data flash of the board: contents, duration of commands, effect of a power failure.
 *
 * An erase sets all bits of a sector to 1, a program command clears bits of a 32-bit word. At a power failure during a command
 * each bit to be changed has changed with a probability equal to the elapsed fraction of the duration (random generator with
 * a seed). Durations are those of a related chip (MK60 data sheet: 14 ms and 65 us typical, 114 ms and 145 us maximum); none
 * are published for this chip.
 */
#ifndef SERVO_TWIN_FLASH_H
#define SERVO_TWIN_FLASH_H

#include <stdbool.h>
#include <stdint.h>

#if defined(BOARD_ODRIVE36) /* of the program flash, what the firmware uses as storage */
#include "config/board_gen.h"
#define FLASH_DATA_SECTORS ((uint32_t)BOARD_FLASH_SECTORS)
#define FLASH_DATA_SECTOR_WORDS ((uint32_t)BOARD_FLASH_SECTOR_WORDS)
#else
#define FLASH_DATA_SECTORS 32u
#define FLASH_DATA_SECTOR_WORDS 256u
#endif
#define FLASH_WORDS (FLASH_DATA_SECTORS * FLASH_DATA_SECTOR_WORDS)

#if defined(BOARD_ODRIVE36) /* typical */
#define FLASH_ERASE_NS UINT64_C(250000000)
#define FLASH_PROGRAM_NS UINT64_C(16000)
#else
#define FLASH_ERASE_NS UINT64_C(14000000)
#define FLASH_PROGRAM_NS UINT64_C(65000)
#endif

#define FLASH_ERASED UINT32_C(0xFFFFFFFF)

/* Image of the non-volatile contents: words and erase counts, low byte first. */
#define FLASH_IMAGE_BYTES (4u * (FLASH_WORDS + FLASH_DATA_SECTORS))

typedef enum { FLASH_NOTHING, FLASH_ERASE, FLASH_PROGRAM } flash_command_t;

typedef struct {
    uint32_t word[FLASH_WORDS];
    uint32_t erases[FLASH_DATA_SECTORS]; /* number of erases of each sector since manufacture */
    flash_command_t command; /* command in progress */
    uint32_t at; /* sector or word of the command */
    uint32_t value; /* word to be programmed */
    uint64_t begin_ns, end_ns; /* begin and end of the command in progress [ns] */
    bool failed; /* the contents after the last command are wrong */
    uint32_t commands; /* commands begun since power-on */
    uint64_t random; /* state of the random generator */
    uint32_t cut_command; /* number of the command with the power failure; 0: none */
    double cut_part; /* elapsed fraction of its duration at the power failure [1] */
    bool dead; /* power has failed */
} flash_t;

/* Initialise at power-on; `image` NULL: erased. */
void flash_init(flash_t *flash, const uint8_t *image, uint64_t seed);

void flash_image(const flash_t *flash, uint8_t *image);

/* Begin a command; none must be in progress. */
void flash_erase(flash_t *flash, uint32_t sector, uint64_t now_ns);
void flash_program(flash_t *flash, uint32_t word, uint32_t value, uint64_t now_ns);

/* Update to the present time. True if a command is in progress. */
bool flash_busy(flash_t *flash, uint64_t now_ns);

/* Abort a command by a reset. */
void flash_break_off(flash_t *flash, uint64_t now_ns);

/* Power failure during a later command (`number` 1: the next one) after the fraction `part` (0..1) of its duration. After the
 * power failure the contents are frozen and a pending command never completes. */
void flash_cut(flash_t *flash, uint32_t number, double part);

#endif
