/* inline.h - what a compiler does not know about the hot path. */
#ifndef PLANT_INLINE_H
#define PLANT_INLINE_H

/* A function that a compiler would call twice rather than copy. */
#ifdef __GNUC__
#define PLANT_INLINE static inline __attribute__((always_inline))
#else
#define PLANT_INLINE static inline
#endif

/* A function of four numbers at once: compiled for processors without registers for them it is there twice, and the
 * processor that it runs on decides. */
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__AVX__)
#define PLANT_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define PLANT_WIDE
#endif

#endif
