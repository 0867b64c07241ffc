/* inline.h - what a compiler does not know about the hot path. */
#ifndef PLANT_INLINE_H
#define PLANT_INLINE_H

/* A function that a compiler would call twice rather than copy, and one that it would copy where once is enough: what runs in a
 * PWM period is twice as much code as a processor keeps at hand. And one that hardly ever runs. */
#ifdef __GNUC__
#define PLANT_INLINE static inline __attribute__((always_inline))
#define PLANT_ONCE __attribute__((noinline))
#define PLANT_RARE __attribute__((noinline, cold))
#define PLANT_VECTORS __attribute__((aligned(32))) /* a table of vectors, none of them in two lines of the cache */
#else
#define PLANT_INLINE static inline
#define PLANT_ONCE
#define PLANT_RARE
#define PLANT_VECTORS
#endif

/* A function of four numbers at once: compiled for processors without registers for them it is there twice, and the
 * processor that it runs on decides. Clang does not inline what has such numbers for arguments into both. */
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__AVX__) && !defined(__clang__)
#define PLANT_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define PLANT_WIDE
#endif

#endif
