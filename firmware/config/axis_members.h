/* axis_members.h - list of the members of axis_config_t, in the order of servo_msgs_py/axis_config.toml. */
#ifndef SERVO_CONFIG_AXIS_MEMBERS_H
#define SERVO_CONFIG_AXIS_MEMBERS_H

#include "config/axis_config.h"
#include "config/axis_layout_gen.h"

#define MEMBER_WIDE 1U   /* 32 bits; otherwise 16 */
#define MEMBER_SIGNED 2U
#define MEMBER_BITS 4U   /* set of bits: `max` of the range has all permitted bits */
#define MEMBER_LIVE 8U   /* may change in motion */

/* Range of a member: no overflow in the control loops. */
typedef struct {
    uint16_t kind; /* MEMBER_ bits */
    int32_t min; /* smallest raw value */
    int32_t max; /* largest raw value */
} axis_range_t;

typedef struct {
    uint16_t offset; /* offset in axis_config_t [bytes] */
    uint16_t range; /* index in axis_ranges */
} axis_member_t;

/* Both tables are in TABLE_MEMORY (comm/table_memory.h). */
extern const axis_range_t axis_ranges[];
extern const axis_member_t axis_members[AXIS_MEMBERS];

/* Access to a member by its number. */
int32_t axis_member_get(const axis_config_t *block, uint16_t number);
void axis_member_set(axis_config_t *block, uint16_t number, int32_t value);
bool axis_member_accepts(uint16_t number, int32_t value);
uint16_t axis_member_kind(uint16_t number); /* MEMBER_ bits */

#endif
