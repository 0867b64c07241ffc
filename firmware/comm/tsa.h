/* tsa.h - target-side addressing: what a client may touch, and how it learns names and types.
 *
 * Addresses on the wire are virtual and lie in five regions; none is ever used as a pointer:
 *   variables   offset in the application's memory, only inside an entry of the table
 *   strings     names and types, readable without the terminating 00
 *   table       the entries as the client expects them, 16 bytes each, produced while they are read
 *   live        variables outside of that memory, read only; `tsa_source_t` says where they are
 *   samples     of the recorders (comm/recorder.h)
 */
#ifndef COMM_TSA_H
#define COMM_TSA_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/table_memory.h"

#ifndef TSA_VARIABLES_BASE
#define TSA_VARIABLES_BASE UINT32_C(0x00001000)
#endif
#ifndef TSA_STRINGS_BASE
#define TSA_STRINGS_BASE UINT32_C(0x00100000)
#endif
#ifndef TSA_TABLE_BASE
#define TSA_TABLE_BASE UINT32_C(0x00200000)
#endif
#ifndef TSA_LIVE_BASE
#define TSA_LIVE_BASE UINT32_C(0x00300000)
#endif
#ifndef TSA_SAMPLES_BASE
#define TSA_SAMPLES_BASE UINT32_C(0x00400000)
#endif

#define TSA_KIND_NONE 0     /* type definition, member, constant */
#define TSA_KIND_RO 1       /* variable, read only */
#define TSA_KIND_RO_FLASH 2 /* the same in flash */
#define TSA_KIND_RW 3       /* variable */

#define TSA_FLAGS UINT8_C(0x13)          /* table version 3, fields of 32 bits */
#define TSA_WIRE_ENTRY_SIZE UINT32_C(16) /* name, type, address, size << 2 | kind: little endian */

typedef struct {
    uint16_t name;    /* offset of the name in the string blob */
    uint16_t type;    /* offset of the type string in the string blob */
    uint32_t address; /* virtual address of the variable, or the value of an ENUM constant */
    uint16_t size;    /* bytes */
    uint16_t kind;    /* TSA_KIND_* */
} tsa_entry_t;

/* Where the loops keep what a variable shows: for those of the region `live`, and for those that are a copy of it. */
typedef struct {
    uint32_t address; /* of the variable */
    uint16_t offset;  /* of its source in the application's live memory */
    uint16_t size;    /* bytes */
} tsa_source_t;

typedef struct {
    const tsa_entry_t *entry; /* in TABLE_MEMORY */
    uint16_t entries; /* number of entries */
    const uint8_t *strings; /* 00-terminated strings one after the other, nothing else; in TABLE_MEMORY */
    uint16_t strings_size; /* bytes */
    const tsa_source_t *source; /* in TABLE_MEMORY */
    uint16_t sources; /* number of sources */
} tsa_table_t;

/* Everything that a client can reach. Entries may overlap: one that covers a range suffices. */
typedef struct {
    const tsa_table_t *table;
    uint8_t *memory;
    uint32_t memory_size; /* bytes */
    const uint8_t *live;
    uint32_t live_size; /* bytes */
} tsa_space_t;

typedef enum { TSA_REGION_VARIABLES, TSA_REGION_STRINGS, TSA_REGION_TABLE, TSA_REGION_LIVE } tsa_region_t;

/* A range that has passed the check. */
typedef struct {
    uint32_t offset; /* from the beginning of the region */
    uint16_t size; /* bytes */
    uint8_t region; /* tsa_region_t */
} tsa_place_t;

static inline tsa_entry_t tsa_entry(const tsa_table_t *table, uint16_t i)
{
    tsa_entry_t entry;
    table_copy(&entry, &table->entry[i], sizeof entry);
    return entry;
}

/* True if `size` bytes at `address` lie in the `extent` bytes at `base`; no sum that could wrap is formed. */
static inline bool tsa_inside(uint32_t address, uint32_t size, uint32_t base, uint32_t extent)
{
    return address >= base && address - base <= extent && size <= extent - (address - base);
}

/* Check `size` bytes at `address` and say where they are; false leaves `place` as it was. */
bool tsa_readable(const tsa_space_t *space, uint32_t address, uint32_t size, tsa_place_t *place);
bool tsa_writable(const tsa_space_t *space, uint32_t address, uint32_t size, tsa_place_t *place);

/* Where the loops keep `size` bytes of a variable, and the largest cell that they are made of (comm/cell.h); NULL if it is
 * none. A variable without a source is its own. */
const uint8_t *tsa_live(const tsa_space_t *space, uint32_t address, uint32_t size, uint8_t *cell);

/* Copy place->size bytes out. */
void tsa_copy(const tsa_space_t *space, const tsa_place_t *place, uint8_t *data);

/* Length without the 00 of the string that begins (or goes on) at `address`; false outside of the strings. */
bool tsa_string_length(const tsa_table_t *table, uint32_t address, uint16_t *length);

/* Bytes that the table takes on the wire. */
uint32_t tsa_table_size(const tsa_table_t *table);

#endif
