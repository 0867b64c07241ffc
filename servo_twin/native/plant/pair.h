/* pair.h - one step of both driven, turning motors at once, one in each lane of a vector register.
 *
 * The Runge-Kutta step waits most of the time for the number before; two axes side by side take hardly longer than one.
 * A lane computes what plant_inverter_step would for its axis alone, to the last bit. What is not the plain case (open
 * switches, a cable that is off, a shaft that stands, or stops within the step) is left to that.
 */
#ifndef PLANT_PAIR_H
#define PLANT_PAIR_H

#include <stdbool.h>

#include "plant/inverter.h"
#include "plant/motor.h"

/* Parameters of both axes, lane by lane (averaged_kernel.h). */
typedef struct {
    double pole_pairs[2], inv_l_d[2], inv_l_q[2], r_d[2], r_q[2], cross_d[2], cross_q[2], emf[2], torque_psi[2],
        torque_l[2], viscous[2], inv_inertia[2], v_drop[2], r_on[2];
    double step; /* [s] */
} plant_pair_t;

/* Both axes after a step. */
typedef struct {
    bool sound[2]; /* the lane may be taken */
    double i_d[2], i_q[2], omega[2], theta[2], sine[2], cosine[2];
    double phase[3][2], share[3][2], leg[3][2];
    double voltage[3][2]; /* of the phases against the midpoint of the bus [V] */
    double charge[2];     /* drawn from the bus [A s] */
} plant_pair_step_t;

void plant_pair_init(plant_pair_t *pair, const plant_inverter_t *inverter_1, const plant_inverter_t *inverter_2,
                     const plant_motor_t *motor_1, const plant_motor_t *motor_2, double step);

/* False if neither axis is the plain case, and always where the compiler has no vectors. */
bool plant_pair_step(const plant_pair_t *pair, const plant_inverter_t *inverter_1, const plant_inverter_t *inverter_2,
                     const plant_motor_t *motor_1, const plant_motor_t *motor_2, double u_dc, plant_pair_step_t *step);

/* The state of one lane becomes that of its axis. */
static inline void plant_pair_take(const plant_pair_step_t *step, int lane, plant_inverter_t *inverter,
                                   plant_motor_t *motor)
{
    motor->i_d = step->i_d[lane];
    motor->i_q = step->i_q[lane];
    motor->omega = step->omega[lane];
    motor->theta = step->theta[lane];
    motor->sine = step->sine[lane];
    motor->cosine = step->cosine[lane];
    motor->steps++;
    for (int k = 0; k < 3; k++) {
        motor->phase[k] = step->phase[k][lane];
        inverter->share[k] = step->share[k][lane];
        inverter->leg[k] = step->leg[k][lane];
    }
}

#endif
