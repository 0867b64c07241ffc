/* divide.h - 64 bits by 16, without the kilobyte of library and the hundreds of instructions of a general division. */
#ifndef SERVO_MATH_DIVIDE_H
#define SERVO_MATH_DIVIDE_H

#include <stdint.h>

/* x / divisor, towards zero; the divisor is not 0, and x is not INT64_MIN. */
int64_t i64_over_u16(int64_t x, uint16_t divisor);

#endif
