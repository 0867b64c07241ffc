/* harm.h - what has been done to the sensors of one axis; the same on both levels of the plant. */
#ifndef PLANT_HARM_H
#define PLANT_HARM_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "plant/sensors.h"

typedef struct {
    bool stuck[3]; /* the current converters of the phases that read as */
    uint16_t code[3];
    double i_whole; /* noise of a current sample, as it should be [A] */
    double glitches[2]; /* mean rate of pulses on the encoder's lines [1/s] */
    bool glitching; /* on the averaged plant: there are some */
    bool heated; /* the power stage keeps its temperature */
    plant_random_t random;
} plant_harm_t;

static inline void plant_harm_init(plant_harm_t *harm, const plant_axis_t *config, uint64_t seed, uint64_t stream)
{
    *harm = (plant_harm_t){.i_whole = config->i_noise};
    plant_random_init(&harm->random, seed, stream);
}

/* Standard deviation of a sample from now on, where it is `present` and was meant to be *whole: damage stays [A], [V]. */
static inline double plant_harm_noise(double *whole, double present, double noise)
{
    const bool harmed = present != *whole;
    *whole = noise;
    return harmed ? present : noise;
}

/* Uniform in 0..1, never 0. */
static inline double plant_harm_chance(plant_harm_t *harm)
{
    return ((double)(plant_random_bits(&harm->random) >> 11) + 1.0) * (1.0 / 9007199254740992.0);
}

/* What a converter shows. */
static inline uint16_t plant_harm_code(const plant_harm_t *harm, int phase, uint16_t code)
{
    return harm->stuck[phase] ? harm->code[phase] : code;
}

#endif
