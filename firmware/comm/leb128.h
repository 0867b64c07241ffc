/* leb128.h - LEB128 numbers of FreeMASTER v4 payloads: seven bits per byte, least significant first; bit 7: more bytes
 * follow.
 *
 * The decoder accepts padded forms and discards bits beyond 32, as the vendor's target does.
 */
#ifndef COMM_LEB128_H
#define COMM_LEB128_H

#include <stdint.h>

#define LEB128_SIZE_MAX 5 /* largest length of the shortest form of a 32-bit number, bytes */

/* Decode one number at `data`; returns its length in bytes, or 0 if it does not end within `size` bytes. */
uint16_t leb128_get_unsigned(const uint8_t *data, uint16_t size, uint32_t *value);
uint16_t leb128_get_signed(const uint8_t *data, uint16_t size, int32_t *value);

/* Encode the shortest form; returns its length. */
uint16_t leb128_put_unsigned(uint8_t data[LEB128_SIZE_MAX], uint32_t value);

#endif
