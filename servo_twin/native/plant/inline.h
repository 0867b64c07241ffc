/* inline.h - functions of the hot path that a compiler would call twice rather than copy. */
#ifndef PLANT_INLINE_H
#define PLANT_INLINE_H

#ifdef __GNUC__
#define PLANT_INLINE static inline __attribute__((always_inline))
#else
#define PLANT_INLINE static inline
#endif

#endif
