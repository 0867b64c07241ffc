/* swept_sine.h - a sine whose frequency grows exponentially: excites a loop to measure its frequency response. */
#ifndef SERVO_CONTROL_SWEPT_SINE_H
#define SERVO_CONTROL_SWEPT_SINE_H

#include "math/frac.h"

typedef struct {
    frac16_t amplitude; /* Q1.15 of the full scale at the test point */
    uint32_t phase;  /* 2^32 is a turn */
    uint32_t step;   /* phase per call */
    uint32_t growth; /* of the step per call, 32 fraction bits */
    uint32_t calls;  /* left until the end */
} swept_sine_t;

/* One sample of amplitude x sin(phase); 0 after the end. The step stays below half a turn. */
frac16_t swept_sine_step(swept_sine_t *sine);

#endif
