/* variables.h - the table of variables that the world outside may see (generated: variables_gen.c). */
#ifndef SERVO_APP_VARIABLES_H
#define SERVO_APP_VARIABLES_H

#include "comm/tsa.h"

extern const tsa_table_t servo_variables;

#endif
