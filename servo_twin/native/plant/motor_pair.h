/* pair.h - one step of both driven motors at once, one in each lane of a vector register.
 *
 * The Runge-Kutta step waits most of the time for the number before; two axes side by side take hardly longer than one.
 * A lane computes what averaged_inverter_step would for its axis alone, but for rounding. What is not the plain case (open
 * switches, a cable that is off or broken, a shaft that stops or breaks loose) is left to that.
 */
#ifndef PLANT_MOTOR_PAIR_H
#define PLANT_MOTOR_PAIR_H

#include <stdbool.h>

#include "plant/averaged_inverter.h"
#include "plant/motor.h"

/* Parameters of both axes, lane by lane (averaged_kernel.h). */
typedef struct {
    double angle[2], inv_l_d[2], inv_l_q[2], r_d[2], r_q[2], cross_d[2], cross_q[2], emf[2], torque_psi[2], torque_l[2],
        viscous[2], per_j[2], v_drop[2], r_on[2];
    double step; /* [s] */
} motor_pair_t;

/* One axis as the pair sees it. */
typedef struct {
    averaged_inverter_t *inverter;
    plant_motor_t *motor;
} motor_lane_t;

void motor_pair_init(motor_pair_t *pair, const motor_lane_t lane[2], double step);

/* Which lanes have been taken: bit 0 the first, bit 1 the second; the others are as they were. 0 always where the compiler
 * has no vectors. `charge` is what these have drawn from the bus [A s]. */
unsigned motor_pair_step(const motor_pair_t *pair, const motor_lane_t lane[2], double u_dc, double *charge);

#endif
