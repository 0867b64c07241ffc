/* divide.h - division of 64 bits by 16, with three 32-bit divisions; a general 64-bit library division takes one
 * kilobyte. */
#ifndef SERVO_MATH_DIVIDE_H
#define SERVO_MATH_DIVIDE_H

#include <stdint.h>

/* x / divisor, rounded towards zero; divisor != 0, x != INT64_MIN. */
int64_t i64_over_u16(int64_t x, uint16_t divisor);

#endif
