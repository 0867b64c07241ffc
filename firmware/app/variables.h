/* variables.h - the tables of variables that the host may read and write (generated: variables_gen.c). */
#ifndef SERVO_APP_VARIABLES_H
#define SERVO_APP_VARIABLES_H

#include "comm/tsa.h"

/* What may be written: the raw range of every element of a variable of servo_t, signed or not. */
typedef struct {
    uint16_t offset; /* in servo_t [bytes] */
    uint16_t size; /* of an element [bytes]: 2 or 4 */
    uint16_t count; /* elements */
    int32_t min; /* raw, the smallest */
    int32_t max; /* raw, the largest */
} variable_range_t;

/* Names of the values 0, 1, ..: offsets in the strings of servo_variables. */
typedef struct {
    const uint16_t *offset;
    uint16_t count; /* names */
} name_list_t;

extern const tsa_table_t servo_variables;
extern const name_list_t servo_state_names;
extern const name_list_t servo_substate_names;
extern const name_list_t servo_refusal_names;
extern const name_list_t servo_fault_names; /* of the bits */
extern const name_list_t servo_copy_names;
extern const variable_range_t servo_ranges[];
extern const uint16_t servo_ranges_count;

#endif
