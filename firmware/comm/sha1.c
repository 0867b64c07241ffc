#include "comm/sha1.h"

#include <string.h>

#define BLOCK 64u
#define WORDS 16u
#define ROUNDS 80u
#define END_MARK 0x80u

static uint32_t rotate(uint32_t word, uint16_t bits)
{
    return (uint32_t)(word << bits) | word >> (uint16_t)(32u - bits);
}

/* Padded message as words: the message, the end mark, zeros and the length in bits. */
static void fill(uint32_t words[WORDS], const uint8_t *message, uint16_t size)
{
    uint8_t block[BLOCK] = {0};
    memcpy(block, message, size);
    block[size] = END_MARK;
    for (uint16_t i = 0; i < WORDS; i++) {
        const uint8_t *bytes = block + 4u * i;
        words[i] = (uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
    }
    words[WORDS - 1u] = 8u * (uint32_t)size;
}

/* Functions and constants of 20 rounds each: choice, parity, majority, parity. */
static uint32_t mix(uint16_t round, uint32_t b, uint32_t c, uint32_t d)
{
    if (round < 20u) {
        return ((b & c) | (~b & d)) + UINT32_C(0x5A827999);
    }
    if (round < 40u) {
        return (b ^ c ^ d) + UINT32_C(0x6ED9EBA1);
    }
    if (round < 60u) {
        return ((b & c) | (b & d) | (c & d)) + UINT32_C(0x8F1BBCDC);
    }
    return (b ^ c ^ d) + UINT32_C(0xCA62C1D6);
}

void sha1(const uint8_t *message, uint16_t size, uint8_t digest[SHA1_SIZE])
{
    const uint32_t start[5] = {UINT32_C(0x67452301), UINT32_C(0xEFCDAB89), UINT32_C(0x98BADCFE), UINT32_C(0x10325476),
                               UINT32_C(0xC3D2E1F0)};
    uint32_t h[5];
    uint32_t words[WORDS]; /* the last 16 words of the schedule */
    fill(words, message, size);
    memcpy(h, start, sizeof h);
    for (uint16_t round = 0; round < ROUNDS; round++) {
        uint32_t *word = &words[round % WORDS];
        if (round >= WORDS) {
            *word = rotate(
                *word ^ words[(round + 2u) % WORDS] ^ words[(round + 8u) % WORDS] ^ words[(round + 13u) % WORDS], 1);
        }
        const uint32_t next = rotate(h[0], 5) + mix(round, h[1], h[2], h[3]) + h[4] + *word;
        h[4] = h[3];
        h[3] = h[2];
        h[2] = rotate(h[1], 30);
        h[1] = h[0];
        h[0] = next;
    }
    for (uint16_t i = 0; i < SHA1_SIZE; i++) {
        const uint32_t word = h[i / 4u] + start[i / 4u];
        digest[i] = (uint8_t)(word >> (24u - 8u * (i % 4u)) & 0xFFu);
    }
}
