#include "plant/noise.h"

void plant_random_init(plant_random_t *random, uint64_t seed, uint64_t stream)
{
    random->state = plant_random_scramble(seed ^ plant_random_scramble(stream + UINT64_C(1)));
}
