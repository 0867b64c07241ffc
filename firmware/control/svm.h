/* svm.h - standard space-vector modulation, centre aligned (DRM 2.3.3, E24..E30, T3). */
#ifndef SERVO_CONTROL_SVM_H
#define SERVO_CONTROL_SVM_H

#include "control/transforms.h"

typedef struct {
    abc_t duty;      /* high-side duties, Q1.15 of 0..100 % */
    uint16_t sector; /* 1 is 0..60 degrees, 6 is 300..360 degrees */
} svm_t;

/* `modulation` is the wanted stator voltage over 2/3 u_dc, the length of the active vectors U0..U300: (1, 0) is U0.
 * Linear modulation ends at sqrt(3)/2. A vector beyond the hexagon is shortened along its direction to the edge. */
svm_t svm(ab_t modulation);

#endif
