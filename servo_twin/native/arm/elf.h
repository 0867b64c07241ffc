/* elf.h - a program in an ELF file for 32-bit Arm, little-endian. */
#ifndef ARM_ELF_H
#define ARM_ELF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "arm/arm.h"

typedef struct {
    const uint8_t *bytes; /* of the file; they stay the caller's */
    size_t size;
} elf_t;

/* NULL, or why these are no bytes of a program. */
const char *elf_check(const elf_t *elf);

/* End of what is loaded at or above `base`, as an offset from there; 0: nothing. */
uint32_t elf_extent(const elf_t *elf, uint32_t base, uint32_t room);

/* Copy everything that is loaded into the region; NULL, or a segment does not lie in it. */
const char *elf_load(const elf_t *elf, const arm_region_t *region);

/* Address at which the byte lies that the program has at `address`; false: in no segment of the file. */
bool elf_load_address(const elf_t *elf, uint32_t address, uint32_t *load);

/* Address and size of a symbol; false: there is none. */
bool elf_symbol(const elf_t *elf, const char *name, uint32_t *address, uint32_t *size);

#endif
