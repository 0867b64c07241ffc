/* svm.h - standard space-vector modulation, centre aligned (DRM 2.3.3, E24..E30, T3). */
#ifndef SERVO_CONTROL_SVM_H
#define SERVO_CONTROL_SVM_H

#include "control/transforms.h"

typedef struct {
    abc_t duty;      /* high-side duties, Q1.15 of 100 % */
    uint16_t sector; /* 1 is 0..60 degrees, 6 is 300..360 degrees */
} svm_t;

#define SVM_FULL INT32_C(32767)
#define SVM_ONE_BY_SQRT3_Q15 INT32_C(18919)

/* Over-modulation: duty of a leg whose active time is shorter than the longest one by `less`, scaled to the period. */
static inline int32_t svm_shortened(int32_t less, int32_t active) { return SVM_FULL - less * SVM_FULL / active; }

/* `modulation` m: commanded stator voltage / (2/3 u_dc), the length of the active vectors U0..U300; (1, 0) is U0. The
 * linear range ends at sqrt(3)/2. Both zero vectors get equal times (E30), as with min-max injection:
 *
 *   x_a = m_alpha + m_beta / sqrt(3),  x_b = 2 m_beta / sqrt(3),  x_c = 0    line voltages to leg c / u_dc
 *   d_k = x_k + (1 - max(x) - min(x)) / 2                                    duties, k = a, b, c
 *   d_k = 1 - (max(x) - x_k) / (max(x) - min(x))                             if max(x) - min(x) > 1
 *
 * The last line shortens a vector outside the hexagon to its edge, with constant direction. */
static inline svm_t svm(ab_t modulation)
{
    /* Projections on the normals of the three sector borders: as parts of the period, how much longer leg a is high
     * than leg c, b than c, b than a. In every sector two of them, with sign, are the active times of E28 and E29. */
    const int32_t alpha = modulation.alpha;
    const int32_t beta_by_sqrt3 = asr32(modulation.beta * SVM_ONE_BY_SQRT3_Q15 + INT32_C(0x4000), 15);
    const int32_t a = beta_by_sqrt3 + alpha;
    const int32_t b = 2 * beta_by_sqrt3;
    const int32_t b_over_a = beta_by_sqrt3 - alpha;

    uint16_t sector;
    int32_t max, min;
    if (b >= 0) {
        if (b_over_a < 0) {
            sector = 1;
            max = a;
            min = 0;
        } else if (a >= 0) {
            sector = 2;
            max = b;
            min = 0;
        } else {
            sector = 3;
            max = b;
            min = a;
        }
    } else if (b_over_a >= 0) {
        sector = 4;
        max = 0;
        min = a;
    } else if (a < 0) {
        sector = 5;
        max = 0;
        min = b;
    } else {
        sector = 6;
        max = a;
        min = b;
    }
    const int32_t active = max - min;
    if (active > SVM_FULL) {
        return (svm_t){{svm_shortened(max - a, active), svm_shortened(max - b, active), svm_shortened(max, active)},
                       sector};
    }
    /* E30: the zero time is shared between O000 and O111, which centres the pulses. */
    const int32_t c = (int32_t)((uint32_t)(SVM_FULL - active) / 2U) - min;
    return (svm_t){{c + a, c + b, c}, sector};
}

#endif
