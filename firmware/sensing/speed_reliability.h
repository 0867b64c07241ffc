/* speed_reliability.h - variance criterion for the observed speed (ST slides "Criterion of a
 * successful start-up", "Detection of a blocked rotor").
 *
 * Mean and variance of the last 64 observed speeds. The speed of a rotating shaft is nearly constant within that time;
 * without back-EMF the observer follows noise.
 */
#ifndef SERVO_SENSING_SPEED_RELIABILITY_H
#define SERVO_SENSING_SPEED_RELIABILITY_H

#include "math/frac.h"

#define SPEED_RELIABILITY_SIZE 64
#define SPEED_RELIABILITY_BITS 6

typedef struct {
    uint16_t period; /* slow ticks per speed */
    /* VARIANCE_THRESHOLD: largest variance / mean^2, 16 fraction bits */
    uint16_t variance_threshold;
    uint16_t hysteresis; /* RELIABILITY_HYSTERESYS: number of consecutive unreliable results that are a fault */
} speed_reliability_config_t;

typedef struct {
    frac16_t speed[SPEED_RELIABILITY_SIZE]; /* Q1.15 of full-scale speed */
    uint16_t next; /* index of the oldest entry */
    uint16_t filled; /* valid entries */
    uint16_t ticks; /* slow ticks since the last entry */
    int32_t sum; /* sum of the speeds, Q1.15 */
    int64_t squares; /* sum of the squared speeds, 30 fraction bits */
    uint16_t failures; /* consecutive unreliable results */
} speed_reliability_t;

void speed_reliability_reset(speed_reliability_t *reliability);

/* One slow tick. True if a speed was stored. */
bool speed_reliability_add(speed_reliability_t *reliability, const speed_reliability_config_t *config, frac32_t speed);

/* True if 64 speeds are stored and their variance is at most mean^2 VARIANCE_THRESHOLD. */
bool speed_reliability_holds(const speed_reliability_t *reliability, const speed_reliability_config_t *config);

/* Mean of the 64 speeds. */
frac32_t speed_reliability_mean(const speed_reliability_t *reliability);

#endif
