/* finite_words.h - bytes as finite numbers of MuJoCo's state.
 *
 * A pattern of NaN is not equal to itself, but users compare states. So a number has seven bytes; the eighth, on top, has the bits of an
 * exponent near 0. Little-endian, as all machines of MuJoCo. Buffers of bytes end with room for an eighth byte.
 */
#ifndef MUJOCO_FINITE_WORDS_H
#define MUJOCO_FINITE_WORDS_H

#include <mujoco/mujoco.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define WORD sizeof(mjtNum)
#define WORD_BYTES 7u
#define TOP_BYTE (UINT64_C(0x3f) << 56)

typedef char words_fit_t[(WORD == sizeof(uint64_t)) ? 1 : -1];

#define FINITE_WORDS(size) (((size) + WORD_BYTES - 1) / WORD_BYTES)

static inline size_t finite_buffer(size_t words) { return WORD_BYTES * words + 1; }

static inline void finite_encode(mjtNum *state, const uint8_t *bytes, size_t words)
{
    for (size_t k = 0; k < words; k++) {
        uint64_t word;
        memcpy(&word, bytes + WORD_BYTES * k, WORD);
        word = (word & ~(UINT64_C(0xff) << 56)) | TOP_BYTE;
        memcpy(&state[k], &word, WORD);
    }
}

static inline void finite_decode(const mjtNum *state, uint8_t *bytes, size_t words)
{
    for (size_t k = 0; k < words; k++) {
        memcpy(bytes + WORD_BYTES * k, &state[k], WORD); /* the next one is written over the top byte */
    }
}

#endif
