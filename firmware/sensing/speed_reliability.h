/* speed_reliability.h - is the observed speed reliable? (ST slides "起动成功的判据", "转子堵转检测")
 *
 * Mean and variance of the last 64 observed speeds. A shaft that turns has a speed that does not change much within so
 * short a time; where there is no back-EMF, the observer follows noise.
 */
#ifndef SERVO_SENSING_SPEED_RELIABILITY_H
#define SERVO_SENSING_SPEED_RELIABILITY_H

#include "math/frac.h"

#define SPEED_RELIABILITY_SIZE 64
#define SPEED_RELIABILITY_BITS 6

typedef struct {
    uint16_t period; /* slow ticks per speed */
    /* VARIANCE_THRESHOLD: largest variance over the square of the mean, 16 fraction bits. */
    uint16_t variance_threshold;
    uint16_t hysteresis; /* RELIABILITY_HYSTERESYS: unreliable speeds in a row that are a fault */
} speed_reliability_config_t;

typedef struct {
    frac16_t speed[SPEED_RELIABILITY_SIZE]; /* Q1.15 of full-scale speed */
    uint16_t next;   /* entry that is the oldest */
    uint16_t filled; /* entries that have been written */
    uint16_t ticks;  /* slow ticks since the last one */
    int32_t sum; /* of the speeds, Q1.15 */
    int64_t squares; /* of their squares, 30 fraction bits */
    uint16_t failures; /* unreliable in a row */
} speed_reliability_t;

void speed_reliability_reset(speed_reliability_t *reliability);

/* One slow tick. True when a speed was taken. */
bool speed_reliability_add(speed_reliability_t *reliability, const speed_reliability_config_t *config, frac32_t speed);

/* All 64 speeds are there, and their variance is at most mean^2 VARIANCE_THRESHOLD. */
bool speed_reliability_holds(const speed_reliability_t *reliability, const speed_reliability_config_t *config);

/* Mean of the 64. */
frac32_t speed_reliability_mean(const speed_reliability_t *reliability);

#endif
