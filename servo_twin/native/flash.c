#include "flash.h"

#include <string.h>

/* splitmix64 */
static uint64_t random64(flash_t *flash)
{
    flash->random += UINT64_C(0x9E3779B97F4A7C15);
    uint64_t z = flash->random;
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

/* Each bit is a one with this probability. */
static uint32_t random_bits(flash_t *flash, double probability)
{
    uint32_t bits = 0;
    for (unsigned k = 0; k < 32u; k++) {
        const double draw = (double)(random64(flash) >> 11) * 0x1p-53;
        bits |= (uint32_t)(draw < probability) << k;
    }
    return bits;
}

static uint32_t word_at(const uint8_t *image)
{
    return image[0] | image[1] << 8 | image[2] << 16 | (uint32_t)image[3] << 24;
}

static void put_word(uint8_t *image, uint32_t word)
{
    for (unsigned k = 0; k < 4u; k++) {
        image[k] = (uint8_t)(word >> (8u * k));
    }
}

void flash_init(flash_t *flash, const uint8_t *image, uint64_t seed)
{
    memset(flash, 0, sizeof *flash);
    flash->random = seed;
    for (uint32_t i = 0; i < FLASH_WORDS; i++) {
        flash->word[i] = (image != NULL) ? word_at(image + 4u * i) : FLASH_ERASED;
    }
    for (uint32_t i = 0; i < FLASH_DATA_SECTORS; i++) {
        flash->erases[i] = (image != NULL) ? word_at(image + 4u * (FLASH_WORDS + i)) : 0u;
    }
}

void flash_image(const flash_t *flash, uint8_t *image)
{
    for (uint32_t i = 0; i < FLASH_WORDS; i++) {
        put_word(image + 4u * i, flash->word[i]);
    }
    for (uint32_t i = 0; i < FLASH_DATA_SECTORS; i++) {
        put_word(image + 4u * (FLASH_WORDS + i), flash->erases[i]);
    }
}

/* `part` of the time of the command has passed: all of it leaves nothing to chance. */
static void change(flash_t *flash, double part)
{
    if (flash->command == FLASH_PROGRAM) {
        uint32_t *word = &flash->word[flash->at];
        const uint32_t cleared = (part < 1.0) ? random_bits(flash, part) : FLASH_ERASED;
        *word &= flash->value | ~cleared;
        return;
    }
    flash->erases[flash->at]++;
    for (uint32_t i = 0; i < FLASH_DATA_SECTOR_WORDS; i++) {
        uint32_t *word = &flash->word[flash->at * FLASH_DATA_SECTOR_WORDS + i];
        *word |= (part < 1.0) ? random_bits(flash, part) : FLASH_ERASED;
    }
}

static double part_at(const flash_t *flash, uint64_t now_ns)
{
    return (double)(now_ns - flash->begin_ns) / (double)(flash->end_ns - flash->begin_ns);
}

static void begin(flash_t *flash, flash_command_t command, uint32_t at, uint32_t value, uint64_t now_ns)
{
    flash->command = command;
    flash->at = at;
    flash->value = value;
    flash->begin_ns = now_ns;
    flash->end_ns = now_ns + ((command == FLASH_ERASE) ? FLASH_ERASE_NS : FLASH_PROGRAM_NS);
    flash->commands++;
}

void flash_erase(flash_t *flash, uint32_t sector, uint64_t now_ns) { begin(flash, FLASH_ERASE, sector, 0, now_ns); }

void flash_program(flash_t *flash, uint32_t word, uint32_t value, uint64_t now_ns)
{
    begin(flash, FLASH_PROGRAM, word, value, now_ns);
}

bool flash_busy(flash_t *flash, uint64_t now_ns)
{
    if (flash->dead || flash->command == FLASH_NOTHING) {
        return flash->dead;
    }
    if (flash->cut_command == flash->commands && part_at(flash, now_ns) >= flash->cut_part) {
        change(flash, flash->cut_part);
        flash->dead = true;
        return true;
    }
    if (now_ns < flash->end_ns) {
        return true;
    }
    change(flash, 1.0);
    flash->failed = flash->command == FLASH_PROGRAM && flash->word[flash->at] != flash->value;
    flash->command = FLASH_NOTHING;
    return false;
}

void flash_break_off(flash_t *flash, uint64_t now_ns)
{
    if (flash_busy(flash, now_ns) && !flash->dead) {
        change(flash, part_at(flash, now_ns));
        flash->command = FLASH_NOTHING;
    }
}

void flash_cut(flash_t *flash, uint32_t number, double part)
{
    flash->cut_command = flash->commands + number;
    flash->cut_part = part;
}
