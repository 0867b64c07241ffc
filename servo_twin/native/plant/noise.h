/* noise.h - reproducible random numbers. */
#ifndef PLANT_NOISE_H
#define PLANT_NOISE_H

#include <stdint.h>

#if defined(__GNUC__) && defined(__x86_64__)
#include <emmintrin.h>
#endif

/* Random number generator (splitmix64). The state is a counter, so the sequences of different streams do not overlap. */
typedef struct {
    uint64_t state;
} plant_random_t;

void plant_random_init(plant_random_t *random, uint64_t seed, uint64_t stream);

static inline uint64_t plant_random_scramble(uint64_t z)
{
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

#define PLANT_RANDOM_STEP UINT64_C(0x9E3779B97F4A7C15)

static inline uint64_t plant_random_bits(plant_random_t *random)
{
    random->state += PLANT_RANDOM_STEP;
    return plant_random_scramble(random->state);
}

/* Skip `count` numbers; the returned generator draws them if they are needed. */
static inline plant_random_t plant_random_reserve(plant_random_t *random, uint64_t count)
{
    const plant_random_t reserved = *random;
    random->state += count * PLANT_RANDOM_STEP;
    return reserved;
}

static inline int32_t plant_sum_of_bytes(uint64_t bytes)
{
#if defined(__GNUC__) && defined(__x86_64__)
    return _mm_cvtsi128_si32(_mm_sad_epu8(_mm_cvtsi64_si128((int64_t)bytes), _mm_setzero_si128()));
#else
    const uint64_t even = UINT64_C(0x00FF00FF00FF00FF);
    const uint64_t pairs = (bytes & even) + ((bytes >> 8) & even);
    return (int32_t)((pairs * UINT64_C(0x0001000100010001)) >> 48);
#endif
}

/* Approximately Gaussian, mean 0, standard deviation 1: the sum of eight bytes, in steps of 1/209, limited to +-4.88. */
static inline double plant_random_gauss(plant_random_t *random)
{
    /* each byte has the mean 127.5 and the variance (2^16 - 1) / 12 */
    return (double)(plant_sum_of_bytes(plant_random_bits(random)) - 1020) * (1.0 / 209.02152999054544);
}

#endif
