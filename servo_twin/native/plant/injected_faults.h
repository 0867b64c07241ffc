/* harm.h - what has been done to the sensors of one axis; the same on both levels of the plant. */
#ifndef PLANT_INJECTED_FAULTS_H
#define PLANT_INJECTED_FAULTS_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "plant/sensors.h"

typedef struct {
    bool stuck[3]; /* the current converters of the phases that read as */
    uint16_t code[3];
    double i_noise_configured; /* noise of a current sample, as it should be [A] */
    double glitches[2]; /* mean rate of pulses on the encoder's lines [1/s] */
    bool has_glitches; /* on the averaged plant: there are some */
    bool sink_held; /* the power stage keeps its temperature */
    plant_random_t random;
} plant_faults_t;

static inline void plant_faults_init(plant_faults_t *faults, const plant_axis_t *config, uint64_t seed, uint64_t stream)
{
    *faults = (plant_faults_t){.i_noise_configured = config->i_noise};
    plant_random_init(&faults->random, seed, stream);
}

/* Standard deviation of a sample from now on, where it is `present` and was meant to be *whole: damage stays [A], [V]. */
static inline double plant_faults_noise(double *configured, double present, double noise)
{
    const bool faulty = present != *configured;
    *configured = noise;
    return faulty ? present : noise;
}

/* Uniform in 0..1, never 0. */
static inline double plant_faults_uniform(plant_faults_t *faults)
{
    return ((double)(plant_random_bits(&faults->random) >> 11) + 1.0) * (1.0 / 9007199254740992.0);
}

/* What a converter shows. */
static inline uint16_t plant_faults_code(const plant_faults_t *faults, int phase, uint16_t code)
{
    return faults->stuck[phase] ? faults->code[phase] : code;
}

#endif
