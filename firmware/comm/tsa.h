/* tsa.h - target-side addressing: table of the variables that a client can access, with names and types.
 *
 * Addresses on the line are virtual, in five regions; they are not used as pointers:
 *   variables   offset in the memory of the application, only within an entry of the table
 *   strings     names and types, readable without the terminating 00
 *   table       entries in the format of the client, 16 bytes each, generated while they are read
 *   live        variables outside of that memory, read only; their location is in tsa_source_t
 *   samples     samples of the recorders (comm/recorder.h)
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
#define TSA_KIND_RO_FLASH 2 /* variable in flash, read only */
#define TSA_KIND_RW 3       /* variable, read and write */

#define TSA_FLAGS UINT8_C(0x13)          /* table version 3, fields of 32 bits */
#define TSA_WIRE_ENTRY_SIZE UINT32_C(16) /* name, type, address, size << 2 | kind: little endian */

typedef struct {
    uint16_t name;    /* offset of the name in the string blob */
    uint16_t type;    /* offset of the type string in the string blob */
    uint32_t address; /* virtual address of the variable, or the value of an ENUM constant */
    uint16_t size;    /* bytes */
    uint16_t kind;    /* TSA_KIND_* */
} tsa_entry_t;

/* Location of the live value in the control loops, for variables of the region `live` and for variables that are
 * copies. */
typedef struct {
    uint32_t address; /* virtual address of the variable */
    uint16_t offset; /* offset of its live value in the live memory of the application, bytes */
    uint16_t size; /* bytes */
} tsa_source_t;

typedef struct {
    const tsa_entry_t *entry; /* in TABLE_MEMORY */
    uint16_t entries; /* number of entries */
    const uint8_t *strings; /* concatenated 00-terminated strings; in TABLE_MEMORY */
    uint16_t strings_size; /* bytes */
    const tsa_source_t *source; /* in TABLE_MEMORY */
    uint16_t sources; /* number of sources */
} tsa_table_t;

/* Memory accessible to a client. Entries may overlap; one entry that contains the range is sufficient. */
typedef struct {
    const tsa_table_t *table;
    uint8_t *memory;
    uint32_t memory_size; /* bytes */
    const uint8_t *live;
    uint32_t live_size; /* bytes */
} tsa_space_t;

typedef enum { TSA_REGION_VARIABLES, TSA_REGION_STRINGS, TSA_REGION_TABLE, TSA_REGION_LIVE } tsa_region_t;

/* Checked range. */
typedef struct {
    uint32_t offset; /* offset in the region, bytes */
    uint16_t size; /* bytes */
    uint8_t region; /* tsa_region_t */
} tsa_place_t;

static inline tsa_entry_t tsa_entry(const tsa_table_t *table, uint16_t i)
{
    tsa_entry_t entry;
    table_copy(&entry, &table->entry[i], sizeof entry);
    return entry;
}

/* Sizes of variables that a recorder or scope accepts, bytes. */
static inline bool tsa_is_variable_size(uint8_t size) { return size == 1 || size == 2 || size == 4 || size == 8; }

/* True if `size` bytes at `address` are within `extent` bytes at `base`; without overflow. */
static inline bool tsa_inside(uint32_t address, uint32_t size, uint32_t base, uint32_t extent)
{
    return address >= base && address - base <= extent && size <= extent - (address - base);
}

/* Check `size` bytes at `address`, and store their location; false: `place` is not changed. */
bool tsa_readable(const tsa_space_t *space, uint32_t address, uint32_t size, tsa_place_t *place);
bool tsa_writable(const tsa_space_t *space, uint32_t address, uint32_t size, tsa_place_t *place);

/* Live location of `size` bytes of a variable, and its largest cell size (comm/cell.h); NULL: not a variable. A
 * variable without a source is itself the live location. */
const uint8_t *tsa_live(const tsa_space_t *space, uint32_t address, uint32_t size, uint8_t *cell);

/* Copy place->size bytes to `data`. */
void tsa_copy(const tsa_space_t *space, const tsa_place_t *place, uint8_t *data);

/* Length without the 00 of the string that begins or continues at `address`; false: not in the strings. */
bool tsa_string_length(const tsa_table_t *table, uint32_t address, uint16_t *length);

/* Size of the table on the line, bytes. */
uint32_t tsa_table_size(const tsa_table_t *table);

#endif
