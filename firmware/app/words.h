/* words.h - 32-bit words in the byte order of the host: least significant byte first. */
#ifndef SERVO_APP_WORDS_H
#define SERVO_APP_WORDS_H

#include <stdint.h>

static inline uint32_t word_at(const uint8_t *data)
{
    uint32_t word = 0;
    for (uint16_t k = 0; k < 4U; k++) {
        word |= (uint32_t)(data[k] & 0xFFU) << (8U * k);
    }
    return word;
}

#endif
