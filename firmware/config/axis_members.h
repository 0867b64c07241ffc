/* axis_members.h - an axis_config_t as the list of its members, in the order of servo_msgs_py/axis_config.toml. */
#ifndef SERVO_CONFIG_AXIS_MEMBERS_H
#define SERVO_CONFIG_AXIS_MEMBERS_H

#include "config/axis_config.h"
#include "config/axis_layout_gen.h"

#define MEMBER_WIDE 1U   /* 32 bits, otherwise 16 */
#define MEMBER_SIGNED 2U
#define MEMBER_BITS 4U   /* a set of bits: the range has all that may be set */
#define MEMBER_LIVE 8U   /* may change in motion */

/* Called with each member: where it is, MEMBER_ bits, and the range that nothing in the loops leaves its format with. */
typedef void (*axis_member_visit_t)(void *context, void *member, uint16_t kind, int32_t min, int32_t max);

void axis_members_visit(axis_config_t *config, axis_member_visit_t visit, void *context);

#endif
