/* sha1.h - SHA-1 (FIPS 180-4) of a message of one block. */
#ifndef COMM_SHA1_H
#define COMM_SHA1_H

#include <stdint.h>

#define SHA1_SIZE 20u
#define SHA1_MESSAGE_MAX 55u /* bytes: one block minus end mark and length */

/* Digest of `size` bytes, at most SHA1_MESSAGE_MAX. */
void sha1(const uint8_t *message, uint16_t size, uint8_t digest[SHA1_SIZE]);

#endif
