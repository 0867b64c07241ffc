/* inline.h - compiler attributes of the hot path. */
#ifndef PLANT_INLINE_H
#define PLANT_INLINE_H

/* PLANT_INLINE: always inline. PLANT_NOINLINE: one copy only, since the code of a PWM period is twice as large as a processor's
 * instruction cache. PLANT_COLD: hardly ever executed. PLANT_ALIGNED: a table of vectors, each within one cache line. */
#ifdef __GNUC__
#define PLANT_INLINE static inline __attribute__((always_inline))
#define PLANT_NOINLINE __attribute__((noinline))
#define PLANT_COLD __attribute__((noinline, cold))
#define PLANT_ALIGNED __attribute__((aligned(32)))
#else
#define PLANT_INLINE static inline
#define PLANT_NOINLINE
#define PLANT_COLD
#define PLANT_ALIGNED
#endif

/* A function of vectors of four doubles. Built for processors without AVX it is compiled twice, and the processor selects the
 * version at run time. Clang does not inline functions with vector arguments into both versions. */
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__AVX__) && !defined(__clang__)
#define PLANT_AVX2_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define PLANT_AVX2_CLONES
#endif

#endif
