/* axis_members.h - list of the members of axis_config_t, in the order of servo_msgs_py/axis_config.toml. */
#ifndef SERVO_CONFIG_AXIS_MEMBERS_H
#define SERVO_CONFIG_AXIS_MEMBERS_H

#include "config/axis_config.h"
#include "config/axis_layout_gen.h"
#include "config/number.h"

typedef struct {
    uint16_t offset; /* offset in axis_config_t [bytes] */
    uint16_t range; /* index in axis_ranges */
} axis_member_t;

/* Both tables are in TABLE_MEMORY (comm/table_memory.h). */
extern const number_range_t axis_ranges[]; /* no overflow in the control loops */
extern const axis_member_t axis_members[AXIS_MEMBERS];

/* Access to a member by its number. */
number_range_t axis_member_range(uint16_t number);
number_t axis_member(axis_config_t *block, uint16_t number);
int32_t axis_member_get(const axis_config_t *block, uint16_t number);
void axis_member_set(axis_config_t *block, uint16_t number, int32_t value);

#endif
