/* injected_faults.h - faults injected into the sensors of one axis, for both levels of the plant. */
#ifndef PLANT_INJECTED_FAULTS_H
#define PLANT_INJECTED_FAULTS_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "plant/noise.h"

typedef struct {
    bool stuck[3]; /* the current converter of the phase is stuck at `code` */
    uint16_t code[3]; /* converter codes */
    double i_noise_configured; /* noise of a current sample without a fault, standard deviation [A] */
    double glitches[2]; /* mean rate of pulses on the encoder lines [1/s] */
    bool has_glitches; /* averaged plant: a rate is not 0 */
    bool sink_held; /* the temperature of the power stage is held */
    plant_random_t random;
} plant_faults_t;

static inline void plant_faults_init(plant_faults_t *faults, const plant_axis_t *config, uint64_t seed, uint64_t stream)
{
    *faults = (plant_faults_t){.i_noise_configured = config->i_noise};
    plant_random_init(&faults->random, seed, stream);
}

/* New standard deviation of a sample after a change of the configured one to `noise` [A], [V]; a fault, present if `present`
 * differs from *configured, is kept. */
static inline double plant_faults_noise(double *configured, double present, double noise)
{
    const bool faulty = present != *configured;
    *configured = noise;
    return faulty ? present : noise;
}

/* Uniformly distributed in 0..1 without 0. */
static inline double plant_faults_uniform(plant_faults_t *faults)
{
    return ((double)(plant_random_bits(&faults->random) >> 11) + 1.0) * (1.0 / 9007199254740992.0);
}

/* Output of the converter of a phase. */
static inline uint16_t plant_faults_code(const plant_faults_t *faults, int phase, uint16_t code)
{
    return faults->stuck[phase] ? faults->code[phase] : code;
}

#endif
