/* root.h - square root of a 64-bit number with three 32-bit divisions. */
#ifndef SERVO_MATH_ROOT_H
#define SERVO_MATH_ROOT_H

#include <stdbool.h>
#include <stdint.h>

/* Square root, rounded down. */
uint32_t u64_sqrt(uint64_t x);

#endif
