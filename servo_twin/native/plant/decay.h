/* decay.h - exponential decay without libm, with the same bits on every processor (trig.h). */
#ifndef PLANT_DECAY_H
#define PLANT_DECAY_H

/* 1 - exp(-x) for x >= 0, by its Taylor series on x / 2^k and the doubling 1 - (1 - y)^2. */
static inline double plant_one_minus_decay(double x)
{
    int doublings = 0;
    while (x > 0.125 && doublings < 64) {
        x *= 0.5;
        doublings++;
    }
    double term = x;
    double y = 0.0;
    for (int n = 2; n < 14; n++) {
        y += term;
        term *= -x / n;
    }
    while (doublings-- > 0) {
        y *= 2.0 - y;
    }
    return y;
}

/* exp(-x) for x >= 0. Squaring preserves the relative precision of small values. */
static inline double plant_decay(double x)
{
    if (x > 700.0) {
        return 0.0;
    }
    int squares = 0;
    while (x > 0.125) {
        x *= 0.5;
        squares++;
    }
    double y = 1.0 - plant_one_minus_decay(x);
    while (squares-- > 0) {
        y *= y;
    }
    return y;
}

#endif
