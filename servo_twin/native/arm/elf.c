#include "arm/elf.h"

#include <string.h>

/* Offsets in the file (System V ABI, chapters 4 and 5). */
enum { E_MACHINE = 18, E_PHOFF = 28, E_SHOFF = 32, E_PHNUM = 44, E_SHNUM = 48, HEADER = 52, MACHINE_ARM = 40 };
enum { P_TYPE = 0, P_OFFSET = 4, P_VADDR = 8, P_PADDR = 12, P_FILESZ = 16, PROGRAM_HEADER = 32, PT_LOAD = 1 };
enum { SH_TYPE = 4, SH_OFFSET = 16, SH_SIZE = 20, SH_LINK = 24, SECTION_HEADER = 40, SHT_SYMTAB = 2 };
enum { ST_NAME = 0, ST_VALUE = 4, ST_SIZE = 8, SYMBOL = 16 };

/* What lies outside of the file reads as 0. */
static uint32_t half(const elf_t *elf, size_t at)
{
    return (at < elf->size && elf->size - at >= 2u) ? (uint32_t)elf->bytes[at] | (uint32_t)elf->bytes[at + 1u] << 8
                                                    : 0u;
}

static uint32_t word(const elf_t *elf, size_t at) { return half(elf, at) | half(elf, at + 2u) << 16; }

static bool inside(const elf_t *elf, uint32_t offset, uint32_t size)
{
    return offset <= elf->size && elf->size - offset >= size;
}

const char *elf_check(const elf_t *elf)
{
    static const uint8_t magic[6] = {0x7F, 'E', 'L', 'F', 1, 1};
    if (elf->size < HEADER || memcmp(elf->bytes, magic, sizeof magic) != 0 || half(elf, E_MACHINE) != MACHINE_ARM) {
        return "this is no ELF file for 32-bit Arm, little-endian";
    }
    const uint32_t first = word(elf, E_PHOFF), count = half(elf, E_PHNUM);
    if (count == 0u || !inside(elf, first, count * PROGRAM_HEADER)) {
        return "the ELF file is incomplete: no program headers";
    }
    for (uint32_t k = 0; k < count; k++) {
        const size_t at = first + k * PROGRAM_HEADER;
        if (word(elf, at + P_TYPE) == PT_LOAD && !inside(elf, word(elf, at + P_OFFSET), word(elf, at + P_FILESZ))) {
            return "the ELF file is incomplete: a segment ends behind it";
        }
    }
    return NULL;
}

uint32_t elf_extent(const elf_t *elf, uint32_t base, uint32_t room)
{
    uint32_t extent = 0;
    for (uint32_t k = 0; k < half(elf, E_PHNUM); k++) {
        const size_t at = word(elf, E_PHOFF) + k * PROGRAM_HEADER;
        const uint32_t offset = word(elf, at + P_PADDR) - base, size = word(elf, at + P_FILESZ);
        if (word(elf, at + P_TYPE) == PT_LOAD && offset < room && room - offset >= size && offset + size > extent) {
            extent = offset + size;
        }
    }
    return extent;
}

const char *elf_load(const elf_t *elf, const arm_region_t *region)
{
    for (uint32_t k = 0; k < half(elf, E_PHNUM); k++) {
        const size_t at = word(elf, E_PHOFF) + k * PROGRAM_HEADER;
        const uint32_t offset = word(elf, at + P_PADDR) - region->base, size = word(elf, at + P_FILESZ);
        if (word(elf, at + P_TYPE) != PT_LOAD || size == 0u) {
            continue;
        }
        if (offset >= region->size || region->size - offset < size) {
            return "the ELF file does not fit: a segment lies outside of the memory of the program";
        }
        memcpy(region->bytes + offset, elf->bytes + word(elf, at + P_OFFSET), size);
    }
    return NULL;
}

bool elf_load_address(const elf_t *elf, uint32_t address, uint32_t *load)
{
    for (uint32_t k = 0; k < half(elf, E_PHNUM); k++) {
        const size_t at = word(elf, E_PHOFF) + k * PROGRAM_HEADER;
        const uint32_t offset = address - word(elf, at + P_VADDR);
        if (word(elf, at + P_TYPE) == PT_LOAD && offset < word(elf, at + P_FILESZ)) {
            *load = word(elf, at + P_PADDR) + offset;
            return true;
        }
    }
    return false;
}

static bool has_name(const elf_t *elf, uint32_t at, const char *name)
{
    const size_t length = strlen(name) + 1u;
    return inside(elf, at, (uint32_t)length) && memcmp(elf->bytes + at, name, length) == 0;
}

bool elf_symbol(const elf_t *elf, const char *name, uint32_t *address, uint32_t *size)
{
    const uint32_t sections = word(elf, E_SHOFF);
    for (uint32_t k = 0; k < half(elf, E_SHNUM); k++) {
        const size_t at = sections + (size_t)k * SECTION_HEADER;
        if (word(elf, at + SH_TYPE) != SHT_SYMTAB) {
            continue;
        }
        const uint32_t names = word(elf, sections + (size_t)word(elf, at + SH_LINK) * SECTION_HEADER + SH_OFFSET);
        const uint32_t first = word(elf, at + SH_OFFSET), bytes = word(elf, at + SH_SIZE);
        for (uint32_t symbol = first; inside(elf, first, bytes) && symbol + SYMBOL <= first + bytes; symbol += SYMBOL) {
            if (has_name(elf, names + word(elf, symbol + ST_NAME), name)) {
                *address = word(elf, symbol + ST_VALUE);
                *size = word(elf, symbol + ST_SIZE);
                return true;
            }
        }
    }
    return false;
}
