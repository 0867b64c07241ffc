/* flash.h - the data flash of the board: what is in it, how long its commands take, and what is left when power fails.
 *
 * An erase makes ones of a sector, a program command clears bits of a word of 32 bits. When power fails under way, each bit
 * that was to change has changed with a probability that is the part of the time that had passed (from a generator with a
 * seed). Times are those of a sibling chip (MK60 data sheet: 14 ms and 65 us typically, 114 ms and 145 us at most): none are
 * published for this one.
 */
#ifndef SERVO_TWIN_FLASH_H
#define SERVO_TWIN_FLASH_H

#include <stdbool.h>
#include <stdint.h>

#define FLASH_SECTORS 32u
#define FLASH_SECTOR_WORDS 256u
#define FLASH_WORDS (FLASH_SECTORS * FLASH_SECTOR_WORDS)

#define FLASH_ERASE_NS UINT64_C(14000000)
#define FLASH_PROGRAM_NS UINT64_C(65000)

#define FLASH_ERASED UINT32_C(0xFFFFFFFF)

/* What stays without power, as bytes in a file: words and erase counts, low byte first. */
#define FLASH_IMAGE_BYTES (4u * (FLASH_WORDS + FLASH_SECTORS))

typedef enum { FLASH_NOTHING, FLASH_ERASE, FLASH_PROGRAM } flash_command_t;

typedef struct {
    uint32_t word[FLASH_WORDS];
    uint32_t erases[FLASH_SECTORS]; /* of each sector since it was made */
    flash_command_t command; /* under way */
    uint32_t at;             /* its sector or word */
    uint32_t value;
    uint64_t begin_ns, end_ns; /* of the command under way [ns] */
    bool failed;       /* the last command has not left what it should */
    uint32_t commands; /* begun since power-on */
    uint64_t random;
    uint32_t cut_command; /* power fails during this one; 0: it does not .. */
    double cut_part;      /* .. when so much of its time has passed */
    bool dead;            /* power has failed */
} flash_t;

/* At power-on; `image` is NULL for an erased one. */
void flash_init(flash_t *flash, const uint8_t *image, uint64_t seed);

void flash_image(const flash_t *flash, uint8_t *image);

/* Begin a command while none is under way. */
void flash_erase(flash_t *flash, uint32_t sector, uint64_t now_ns);
void flash_program(flash_t *flash, uint32_t word, uint32_t value, uint64_t now_ns);

/* Bring it along to the present: is a command under way? */
bool flash_busy(flash_t *flash, uint64_t now_ns);

/* A reset ends a command where it is. */
void flash_break_off(flash_t *flash, uint64_t now_ns);

/* Power fails during the command `number` from now on (1: the next one), when `part` (0..1) of its time has passed. From
 * then on nothing changes any more and a command never ends: all that the software does afterwards is of no consequence. */
void flash_cut(flash_t *flash, uint32_t number, double part);

#endif
