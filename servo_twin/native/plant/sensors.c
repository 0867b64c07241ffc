#include "plant/sensors.h"

static uint64_t scramble(uint64_t z)
{
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

uint64_t plant_random_bits(plant_random_t *random)
{
    random->state += UINT64_C(0x9E3779B97F4A7C15);
    return scramble(random->state);
}

void plant_random_init(plant_random_t *random, uint64_t seed, uint64_t stream)
{
    random->state = scramble(seed ^ scramble(stream + UINT64_C(1)));
}

double plant_random_gauss(plant_random_t *random)
{
    const uint64_t bytes = plant_random_bits(random);
    const uint64_t even = UINT64_C(0x00FF00FF00FF00FF);
    const uint64_t pairs = (bytes & even) + ((bytes >> 8) & even);
    const int32_t sum = (int32_t)((pairs * UINT64_C(0x0001000100010001)) >> 48);
    /* each byte has the mean 127.5 and the variance (2^16 - 1) / 12 */
    return (double)(sum - 1020) * (1.0 / 209.02152999054544);
}

uint16_t plant_code_bipolar(double value, double full_scale)
{
    return plant_code(2048.0 + value / full_scale * 2048.0);
}

uint16_t plant_code_unipolar(double value, double full_scale) { return plant_code(value / full_scale * 4096.0); }
