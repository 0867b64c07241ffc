/* crc32.h - CRC-32 as in zlib: reflected, polynomial 04C11DB7h. */
#ifndef SERVO_MATH_CRC32_H
#define SERVO_MATH_CRC32_H

#include <stdint.h>

#define CRC32_START UINT32_C(0xFFFFFFFF)

/* Append the low `size` bytes of `value` to the sum, lowest byte first. */
uint32_t crc32_add(uint32_t crc, uint32_t value, uint16_t size);

static inline uint32_t crc32_end(uint32_t crc) { return crc ^ UINT32_C(0xFFFFFFFF); }

#endif
