#include "config/axis_members.h"

#include "comm/table_memory.h"

static axis_member_t member_at(uint16_t number)
{
    axis_member_t member;
    table_copy(&member, &axis_members[number], sizeof member);
    return member;
}

static axis_range_t range_of(uint16_t number)
{
    axis_range_t range;
    table_copy(&range, &axis_ranges[member_at(number).range], sizeof range);
    return range;
}

int32_t axis_member_get(const axis_config_t *block, uint16_t number)
{
    const void *member = (const uint8_t *)block + member_at(number).offset;
    const uint16_t kind = range_of(number).kind;
    if ((kind & MEMBER_WIDE) != 0U) {
        return (kind & MEMBER_SIGNED) != 0U ? *(const int32_t *)member : (int32_t)(*(const uint32_t *)member);
    }
    return (kind & MEMBER_SIGNED) != 0U ? *(const int16_t *)member : (int32_t)(*(const uint16_t *)member);
}

void axis_member_set(axis_config_t *block, uint16_t number, int32_t value)
{
    void *member = (uint8_t *)block + member_at(number).offset;
    const uint16_t kind = range_of(number).kind;
    if ((kind & MEMBER_WIDE) != 0U) {
        if ((kind & MEMBER_SIGNED) != 0U) {
            *(int32_t *)member = value;
        } else {
            *(uint32_t *)member = (uint32_t)value;
        }
    } else if ((kind & MEMBER_SIGNED) != 0U) {
        *(int16_t *)member = (int16_t)value;
    } else {
        *(uint16_t *)member = (uint16_t)value;
    }
}

bool axis_member_accepts(uint16_t number, int32_t value)
{
    const axis_range_t range = range_of(number);
    const bool bits = (range.kind & MEMBER_BITS) == 0U || ((uint32_t)value & ~(uint32_t)range.max) == 0U;
    return value >= range.min && value <= range.max && bits;
}

uint16_t axis_member_kind(uint16_t number) { return range_of(number).kind; }
