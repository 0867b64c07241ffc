/* saturate.h - saturation to 16 bits.
 *
 * Cortex-M shifts and saturates in one instruction (SSAT, USAT), which compilers rarely generate from C. The assembly
 * code is bit-identical to the C code (`make targets`).
 */
#ifndef SERVO_MATH_SATURATE_H
#define SERVO_MATH_SATURATE_H

#include <stdbool.h>
#include <stdint.h>

/* Arithmetic shift right (rounds towards minus infinity). In C99 the right shift of a negative number is
 * implementation-defined; compilers translate this form to one instruction. */
static inline int32_t asr32(int32_t x, unsigned n) { return (x < 0) ? (int32_t)~(~x >> n) : (int32_t)(x >> n); }

#if defined(__ARM_FEATURE_SAT) && defined(__OPTIMIZE__)

#define SATURATE_INLINE static inline __attribute__((always_inline))

/* States the range of a result of assembly code to the compiler: avoids sign extensions. */
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

/* sat16(asr32(x, n)); n is a constant from 1 to 31. */
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
