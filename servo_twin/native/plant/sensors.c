#include "plant/sensors.h"

void plant_random_init(plant_random_t *random, uint64_t seed, uint64_t stream)
{
    random->state = plant_random_scramble(seed ^ plant_random_scramble(stream + UINT64_C(1)));
}

uint16_t plant_code_unipolar(double value, double full_scale) { return plant_code(value / full_scale * 4096.0); }
