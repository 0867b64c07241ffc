/* arithmetic.h - the functions of math/, control/, sensing/ and of current sensing with numbers that do not occur in
 * runs: the ends of their ranges and random numbers in between, the same on every machine. */
#ifndef TARGETS_ARITHMETIC_H
#define TARGETS_ARITHMETIC_H

#include <stdint.h>

/* CFFI-BEGIN: also read by the Python side */
/* Groups of functions, and their names. */
uint16_t arithmetic_groups(void);
const char *arithmetic_name(uint16_t group);

/* Check value over `rounds` rounds of one group. */
uint32_t arithmetic_digest(uint16_t group, uint32_t seed, uint32_t rounds);
/* CFFI-END */

#endif
