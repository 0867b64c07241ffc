/* swept_sine.h - test signal for frequency responses: sine with exponentially increasing frequency. */
#ifndef SERVO_CONTROL_SWEPT_SINE_H
#define SERVO_CONTROL_SWEPT_SINE_H

#include "math/frac.h"

typedef struct {
    frac16_t amplitude; /* Q1.15 of the full scale at the test point */
    uint32_t phase;  /* phase, 2^32 is one turn */
    uint32_t step;   /* phase per call */
    uint32_t growth; /* relative increase of the step per call, 32 fraction bits */
    uint32_t calls;  /* remaining calls */
} swept_sine_t;

/* Next sample of amplitude x sin(phase); 0 after the end. `step` must stay below half a turn. */
frac16_t swept_sine_step(swept_sine_t *sine);

#endif
