/* crc8.h - CRC-8 of FreeMASTER v4: polynomial x^8 + x^2 + x + 1, initial value 0, most significant bit first. */
#ifndef COMM_CRC8_H
#define COMM_CRC8_H

#include <stdint.h>

#define CRC8_START UINT8_C(0)

/* Append one byte to the sum. */
uint8_t crc8_add(uint8_t crc, uint8_t byte);

#endif
