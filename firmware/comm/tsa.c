#include "comm/tsa.h"

#include <stddef.h>
#include <string.h>

#include "comm/cell.h"

#define TYPE_NOT_MAPPED 0xEDu /* first byte of the types of STRUCT, ENUM, CONST, DIR: entries without memory */

#define FIELD_SIZE 4u

static bool is_mapped(const tsa_table_t *table, const tsa_entry_t *entry)
{
    return entry->type < table->strings_size && table_byte(table->strings + entry->type) != TYPE_NOT_MAPPED;
}

static bool in_variable(const tsa_space_t *space, uint32_t address, uint32_t size, bool writing)
{
    const tsa_table_t *table = space->table;
    if (!tsa_inside(address, size, TSA_VARIABLES_BASE, space->memory_size)) {
        return false; /* even with a wrong table nothing outside of the shared memory is accessible */
    }
    for (uint16_t i = 0; i < table->entries; i++) {
        const tsa_entry_t entry = tsa_entry(table, i);
        const bool allowed = writing ? entry.kind == TSA_KIND_RW : entry.kind != TSA_KIND_NONE;
        if (allowed && tsa_inside(address, size, entry.address, entry.size) && is_mapped(table, &entry)) {
            return true;
        }
    }
    return false;
}

/* The blob consists of strings only, so a range without 00 lies within one string. */
static bool in_string(const tsa_table_t *table, uint32_t address, uint32_t size)
{
    if (!tsa_inside(address, size, TSA_STRINGS_BASE, table->strings_size)) {
        return false;
    }
    const uint8_t *at = table->strings + (size_t)(address - TSA_STRINGS_BASE);
    const uint8_t *end = at + (size_t)size;
    while (at != end && table_byte(at) != 0) {
        at++;
    }
    return at == end;
}

/* Find the source of a range in live memory; false if it has none. */
static bool find_source(const tsa_space_t *space, uint32_t address, uint32_t size, uint32_t *offset)
{
    for (uint16_t i = 0; i < space->table->sources; i++) {
        tsa_source_t source;
        table_copy(&source, &space->table->source[i], sizeof source);
        if (tsa_inside(address, size, source.address, source.size)) {
            *offset = source.offset + (address - source.address);
            return tsa_inside(*offset, size, 0, space->live_size);
        }
    }
    return false;
}

static bool fill(tsa_place_t *place, tsa_region_t region, uint32_t offset, uint32_t size)
{
    if (size > UINT16_MAX) {
        return false;
    }
    place->offset = offset;
    place->size = (uint16_t)size;
    place->region = (uint8_t)region;
    return true;
}

bool tsa_readable(const tsa_space_t *space, uint32_t address, uint32_t size, tsa_place_t *place)
{
    if (in_variable(space, address, size, false)) {
        return fill(place, TSA_REGION_VARIABLES, address - TSA_VARIABLES_BASE, size);
    }
    if (in_string(space->table, address, size)) {
        return fill(place, TSA_REGION_STRINGS, address - TSA_STRINGS_BASE, size);
    }
    if (tsa_inside(address, size, TSA_TABLE_BASE, tsa_table_size(space->table))) {
        return fill(place, TSA_REGION_TABLE, address - TSA_TABLE_BASE, size);
    }
    uint32_t offset = 0;
    return address >= TSA_LIVE_BASE && find_source(space, address, size, &offset) &&
           fill(place, TSA_REGION_LIVE, offset, size);
}

bool tsa_writable(const tsa_space_t *space, uint32_t address, uint32_t size, tsa_place_t *place)
{
    return in_variable(space, address, size, true) &&
           fill(place, TSA_REGION_VARIABLES, address - TSA_VARIABLES_BASE, size);
}

const uint8_t *tsa_live(const tsa_space_t *space, uint32_t address, uint32_t size, uint8_t *cell)
{
    uint32_t offset = 0;
    const uint8_t *memory = space->live;
    if (!find_source(space, address, size, &offset)) {
        if (!in_variable(space, address, size, false)) {
            return NULL;
        }
        offset = address - TSA_VARIABLES_BASE;
        memory = space->memory;
    }
    *cell = cell_of(offset, size);
    return memory + (size_t)offset;
}

/* The loops may change the value during the copy: each number is read in one access. */
static void copy_live(const uint8_t *from, const tsa_place_t *place, uint8_t *data)
{
    const uint8_t cell = cell_of(place->offset, place->size);
    if (place->size == 2 && cell == 2) {
        const uint16_t value = *(const cell2_t *)(const void *)from;
        memcpy(data, &value, sizeof value);
    } else if (place->size == 4 && cell == 4) {
        const uint32_t value = *(const cell4_t *)(const void *)from;
        memcpy(data, &value, sizeof value);
    } else {
        memcpy(data, from, place->size);
    }
}

static uint8_t wire_byte(const tsa_table_t *table, uint32_t offset)
{
    const tsa_entry_t entry = tsa_entry(table, (uint16_t)(offset / TSA_WIRE_ENTRY_SIZE));
    const unsigned at = (unsigned)(offset % TSA_WIRE_ENTRY_SIZE);
    const uint32_t field[] = {
        TSA_STRINGS_BASE + entry.name,
        TSA_STRINGS_BASE + entry.type,
        entry.address,
        (uint32_t)entry.size << 2 | entry.kind,
    };
    return (uint8_t)(field[at / FIELD_SIZE] >> (8u * (at % FIELD_SIZE)) & 0xFFu);
}

void tsa_copy(const tsa_space_t *space, const tsa_place_t *place, uint8_t *data)
{
    switch ((tsa_region_t)place->region) {
    case TSA_REGION_VARIABLES:
        memcpy(data, space->memory + (size_t)place->offset, place->size);
        break;
    case TSA_REGION_STRINGS:
        table_copy(data, space->table->strings + (size_t)place->offset, place->size);
        break;
    case TSA_REGION_TABLE:
        for (uint16_t i = 0; i < place->size; i++) {
            data[i] = wire_byte(space->table, place->offset + i);
        }
        break;
    case TSA_REGION_LIVE:
        copy_live(space->live + (size_t)place->offset, place, data);
        break;
    }
}

bool tsa_string_length(const tsa_table_t *table, uint32_t address, uint16_t *length)
{
    if (!tsa_inside(address, 1, TSA_STRINGS_BASE, table->strings_size)) {
        return false;
    }
    const uint16_t offset = (uint16_t)(address - TSA_STRINGS_BASE);
    uint16_t end = offset;
    while (end < table->strings_size && table_byte(table->strings + end) != 0) {
        end++;
    }
    *length = (uint16_t)(end - offset);
    return true;
}

uint32_t tsa_table_size(const tsa_table_t *table) { return TSA_WIRE_ENTRY_SIZE * table->entries; }
