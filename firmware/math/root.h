/* root.h - square root of 64 bits with three divisions of 32. */
#ifndef SERVO_MATH_ROOT_H
#define SERVO_MATH_ROOT_H

#include <stdbool.h>
#include <stdint.h>

/* Square root, rounded down. */
uint32_t u64_sqrt(uint64_t x);

#endif
