/* divide.h - 64 bits by 16, with three divisions of 32 bits instead of the kilobyte of library of a general one. */
#ifndef SERVO_MATH_DIVIDE_H
#define SERVO_MATH_DIVIDE_H

#include <stdint.h>

/* x / divisor, towards zero; the divisor is not 0, and x is not INT64_MIN. */
int64_t i64_over_u16(int64_t x, uint16_t divisor);

#endif
