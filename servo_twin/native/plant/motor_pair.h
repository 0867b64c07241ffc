/* motor_pair.h - one step of both driven motors at once, one in each lane of a vector register.
 *
 * The Runge-Kutta step is a chain of dependent operations; two axes in parallel take hardly longer than one. A lane gives
 * the result of averaged_inverter_step for its axis, but for rounding. Open switches, a disconnected or broken cable and a
 * shaft that stops or starts are left to averaged_inverter_step.
 */
#ifndef PLANT_MOTOR_PAIR_H
#define PLANT_MOTOR_PAIR_H

#include <stdbool.h>

#include "plant/averaged_inverter.h"
#include "plant/motor.h"

/* Parameters of both axes by lane; names and units as in averaged_kernel.h, per_j is h / (2 J). */
typedef struct {
    double angle[2], inv_l_d[2], inv_l_q[2], r_d[2], r_q[2], cross_d[2], cross_q[2], emf[2], torque_psi[2], torque_l[2],
        viscous[2], per_j[2], v_drop[2], r_on[2];
    double step; /* [s] */
} motor_pair_t;

/* One axis. */
typedef struct {
    averaged_inverter_t *inverter;
    plant_motor_t *motor;
} motor_lane_t;

void motor_pair_init(motor_pair_t *pair, const motor_lane_t lane[2], double step);

/* Returns the lanes that have made the step: bit 0 the first, bit 1 the second; the others are unchanged. Always 0 if the compiler
 * has no vectors. *charge becomes the charge that these lanes have drawn from the bus [A s]. */
unsigned motor_pair_step(const motor_pair_t *pair, const motor_lane_t lane[2], double u_dc, double *charge);

#endif
