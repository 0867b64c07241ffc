/* saturate.h - saturation to 16 bits, with the instruction for it where the machine has one.
 *
 * Cortex-M shifts and saturates in one instruction (SSAT, USAT), which compilers find only now and then by themselves.
 * What is written here for it does the same as the C below it, bit for bit (`make targets`).
 */
#ifndef SERVO_MATH_SATURATE_H
#define SERVO_MATH_SATURATE_H

#include <stdbool.h>
#include <stdint.h>

/* Shift right and round towards minus infinity. C99 leaves the right shift of a negative number to the compiler; this
 * form is defined everywhere, and compilers make one instruction of it. */
static inline int32_t asr32(int32_t x, unsigned n) { return (x < 0) ? (int32_t)~(~x >> n) : (int32_t)(x >> n); }

#if defined(__ARM_FEATURE_SAT) && defined(__OPTIMIZE__)

#define SATURATE_INLINE static inline __attribute__((always_inline))

/* Tells the compiler what it cannot see, so that it extends no signs. */
#define SATURATE_IS(holds)                                                                                             \
    do {                                                                                                               \
        if (!(holds)) {                                                                                                \
            __builtin_unreachable();                                                                                   \
        }                                                                                                              \
    } while (false)

SATURATE_INLINE int16_t sat16(int32_t x)
{
    int32_t result;
    __asm__("ssat %0, #16, %1" : "=r"(result) : "r"(x));
    SATURATE_IS(result >= INT16_MIN && result <= INT16_MAX);
    return (int16_t)result;
}

SATURATE_INLINE int16_t sat16_asr(int32_t x, unsigned n)
{
    int32_t result;
    __asm__("ssat %0, #16, %1, asr %2" : "=r"(result) : "r"(x), "I"(n));
    SATURATE_IS(result >= INT16_MIN && result <= INT16_MAX);
    return (int16_t)result;
}

SATURATE_INLINE int16_t sat15(int32_t x)
{
    int32_t result;
    __asm__("usat %0, #15, %1" : "=r"(result) : "r"(x));
    SATURATE_IS(result >= 0 && result <= INT16_MAX);
    return (int16_t)result;
}

#else

/* Saturate to [-1, 1). */
static inline int16_t sat16(int32_t x)
{
    if (x > INT16_MAX) {
        return INT16_MAX;
    }
    if (x < INT16_MIN) {
        return INT16_MIN;
    }
    return (int16_t)x;
}

/* The same of asr32(x, n); n is a constant from 1 to 31. */
static inline int16_t sat16_asr(int32_t x, unsigned n) { return sat16(asr32(x, n)); }

/* Saturate to [0, 1). */
static inline int16_t sat15(int32_t x)
{
    if (x > INT16_MAX) {
        return INT16_MAX;
    }
    return (x < 0) ? 0 : (int16_t)x;
}

#endif
#endif
