/* axis_members.h - an axis_config_t as the list of its members, in the order of servo_msgs_py/axis_config.toml. */
#ifndef SERVO_CONFIG_AXIS_MEMBERS_H
#define SERVO_CONFIG_AXIS_MEMBERS_H

#include "config/axis_config.h"
#include "config/axis_layout_gen.h"

#define MEMBER_WIDE 1U   /* 32 bits, otherwise 16 */
#define MEMBER_SIGNED 2U
#define MEMBER_BITS 4U   /* a set of bits: the range has all that may be set */
#define MEMBER_LIVE 8U   /* may change in motion */

/* What nothing in the loops leaves its format with. */
typedef struct {
    uint16_t kind; /* MEMBER_ bits */
    int32_t min; /* raw, the smallest */
    int32_t max; /* raw, the largest */
} axis_range_t;

typedef struct {
    uint16_t offset; /* in an axis_config_t [bytes] */
    uint16_t range; /* index in axis_ranges */
} axis_member_t;

/* Both in the memory of large tables: comm/table_memory.h. */
extern const axis_range_t axis_ranges[];
extern const axis_member_t axis_members[AXIS_MEMBERS];

/* A member by its number. */
int32_t axis_member_get(const axis_config_t *block, uint16_t number);
void axis_member_set(axis_config_t *block, uint16_t number, int32_t value);
bool axis_member_accepts(uint16_t number, int32_t value);
uint16_t axis_member_kind(uint16_t number); /* MEMBER_ bits */

#endif
