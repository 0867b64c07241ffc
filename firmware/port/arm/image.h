/* image.h - what the images of both Cortex-M4 ports have in common: memories at the start, places for a debugger. */
#ifndef ARM_IMAGE_H
#define ARM_IMAGE_H

#include <stdint.h>

/* Offset of the snapshot in servo_t, its size, offsets of the winding temperatures of both axes and of what a client may access. */
extern const uint32_t image_layout[5];

/* Out of reset there are no functions of a library yet: volatile, so that the compiler does not call one. */
static inline void image_copy(volatile uint32_t *to, const uint32_t *end, const uint32_t *from)
{
    while (to < end) {
        *to++ = *from++;
    }
}

static inline void image_clear(volatile uint32_t *to, const uint32_t *end)
{
    while (to < end) {
        *to++ = 0;
    }
}

#endif
