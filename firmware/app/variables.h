/* variables.h - tables of the variables that the host can read and write (generated: variables_gen.c). */
#ifndef SERVO_APP_VARIABLES_H
#define SERVO_APP_VARIABLES_H

#include "comm/tsa.h"
#include "config/number.h"

/* Writable variable of servo_t. */
typedef struct {
    uint16_t offset; /* offset in servo_t [bytes] */
    uint16_t count; /* number of elements */
    number_range_t range; /* of each element */
} variable_range_t;

/* Names of the values 0, 1, 2 ..., as offsets in the strings of servo_variables. */
typedef struct {
    const uint16_t *offset;
    uint16_t count; /* number of names */
} name_list_t;

extern const tsa_table_t servo_variables;
extern const name_list_t servo_state_names;
extern const name_list_t servo_substate_names;
extern const name_list_t servo_refusal_names;
extern const name_list_t servo_fault_names; /* names of the bits */
extern const name_list_t servo_copy_names;
extern const variable_range_t servo_ranges[];
extern const uint16_t servo_ranges_count;

#endif
