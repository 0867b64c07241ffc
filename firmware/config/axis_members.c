#include "config/axis_members.h"

#include "comm/table_memory.h"

static axis_member_t member_at(uint16_t number)
{
    axis_member_t member;
    table_copy(&member, &axis_members[number], sizeof member);
    return member;
}

number_range_t axis_member_range(uint16_t number)
{
    number_range_t range;
    table_copy(&range, &axis_ranges[member_at(number).range], sizeof range);
    return range;
}

number_t axis_member(axis_config_t *block, uint16_t number)
{
    return (number_t){(uint8_t *)block + member_at(number).offset, axis_member_range(number)};
}

int32_t axis_member_get(const axis_config_t *block, uint16_t number)
{
    return number_get((const uint8_t *)block + member_at(number).offset, axis_member_range(number).kind);
}

void axis_member_set(axis_config_t *block, uint16_t number, int32_t value)
{
    const number_t member = axis_member(block, number);
    number_set(member.at, member.range.kind, value);
}
