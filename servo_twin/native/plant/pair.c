#include "plant/pair.h"

#include <string.h>

#include "plant/trig.h"

#ifdef __GNUC__

#ifdef __SSE2__
#include <emmintrin.h>
#endif

typedef double pair_t __attribute__((vector_size(16)));

static inline pair_t pair_of(const double lanes[2])
{
    pair_t x;
    memcpy(&x, lanes, sizeof x);
    return x;
}

static inline void store(double lanes[2], pair_t x) { memcpy(lanes, &x, sizeof x); }

static inline pair_t both(double x) { return (pair_t){x, x}; }

static inline pair_t limit_pair(pair_t x, double low, double high)
{
#ifdef __SSE2__
    return (pair_t)_mm_min_pd(_mm_max_pd((__m128d)x, _mm_set1_pd(low)), _mm_set1_pd(high));
#else
    return (pair_t){plant_limit(x[0], low, high), plant_limit(x[1], low, high)};
#endif
}

#define NUM pair_t
#define KERNEL(name) pair_##name
#define LIMIT(x, low, high) limit_pair(x, low, high)
#include "plant/averaged_kernel.h"

static bool plain_case(const plant_inverter_t *inverter, const plant_motor_t *motor)
{
    return inverter->on && !inverter->unplugged && !motor->locked &&
           (motor->omega > PLANT_STANDING || motor->omega < -PLANT_STANDING) && motor->steps < PLANT_FRESH_TRIG;
}

#define LANES(member) ((pair_t){a->member, b->member})

bool plant_pair_step(const plant_pair_t *pair, const plant_inverter_t *inverter_1, const plant_inverter_t *inverter_2,
                     const plant_motor_t *motor_1, const plant_motor_t *motor_2, double u_dc, plant_pair_step_t *step)
{
    step->sound[0] = plain_case(inverter_1, motor_1);
    step->sound[1] = plain_case(inverter_2, motor_2);
    if (!step->sound[0] && !step->sound[1]) {
        return false;
    }
    pair_t share[3];
    pair_t leg[3];
    pair_t before[3];
    const pair_t v_drop = pair_of(pair->v_drop);
    {
        const plant_inverter_t *a = inverter_1;
        const plant_inverter_t *b = inverter_2;
        for (int k = 0; k < 3; k++) {
            before[k] = (pair_t){motor_1->phase[k], motor_2->phase[k]};
            share[k] = pair_drive_leg(before[k], LANES(inv_i_w), LANES(duty[k]), LANES(dead_leg[k]), v_drop, u_dc,
                                      &leg[k]);
        }
    }
    const plant_motor_t *a = motor_1;
    const plant_motor_t *b = motor_2;
    const pair_t direction = {(a->omega > 0.0) ? 1.0 : -1.0, (b->omega > 0.0) ? 1.0 : -1.0};
    const pair_step_t m = {
        .pole_pairs = pair_of(pair->pole_pairs),
        .inv_l_d = pair_of(pair->inv_l_d),
        .inv_l_q = pair_of(pair->inv_l_q),
        .r_d = pair_of(pair->r_d),
        .r_q = pair_of(pair->r_q),
        .cross_d = pair_of(pair->cross_d),
        .cross_q = pair_of(pair->cross_q),
        .emf = pair_of(pair->emf),
        .torque_psi = pair_of(pair->torque_psi),
        .torque_l = pair_of(pair->torque_l),
        .viscous = pair_of(pair->viscous),
        .drag = (LANES(load) + direction * LANES(friction)) * pair_of(pair->inv_inertia),
    };
    const pair_t sine = LANES(sine);
    const pair_t cosine = LANES(cosine);
    const pair_t alpha = (2.0 * leg[0] - leg[1] - leg[2]) * (1.0 / 3.0);
    const pair_t beta = (leg[1] - leg[2]) * 0.57735026918962576451;
    const pair_vector_t u = {alpha * cosine + beta * sine, beta * cosine - alpha * sine};
    pair_state_t x = {LANES(i_d), LANES(i_q), LANES(omega)};
    pair_vector_t e;
    const pair_t theta = LANES(theta) + pair_runge_kutta(&m, u, pair->step, &x, &e);
    const pair_t cosine_after = cosine * e.alpha - sine * e.beta;
    const pair_t sine_after = sine * e.alpha + cosine * e.beta;
    pair_t after[3];
    pair_phases(x.i_d, x.i_q, sine_after, cosine_after, after);
    const pair_t r_on = pair_of(pair->r_on);
    pair_t charge = both(0.0);
    for (int k = 0; k < 3; k++) {
        charge += share[k] * 0.5 * (before[k] + after[k]) * pair->step;
        store(step->phase[k], after[k]);
        store(step->share[k], share[k]);
        store(step->leg[k], leg[k]);
        store(step->voltage[k], leg[k] - r_on * after[k] - 0.5 * u_dc);
    }
    store(step->charge, charge);
    store(step->i_d, x.i_d);
    store(step->i_q, x.i_q);
    store(step->omega, x.omega);
    store(step->theta, theta);
    store(step->sine, sine_after);
    store(step->cosine, cosine_after);
    step->sound[0] = step->sound[0] && step->omega[0] * direction[0] >= 0.0;
    step->sound[1] = step->sound[1] && step->omega[1] * direction[1] >= 0.0;
    return true;
}

#else

bool plant_pair_step(const plant_pair_t *pair, const plant_inverter_t *inverter_1, const plant_inverter_t *inverter_2,
                     const plant_motor_t *motor_1, const plant_motor_t *motor_2, double u_dc, plant_pair_step_t *step)
{
    (void)pair;
    (void)inverter_1;
    (void)inverter_2;
    (void)motor_1;
    (void)motor_2;
    (void)u_dc;
    (void)step;
    return false;
}

#endif

void plant_pair_init(plant_pair_t *pair, const plant_inverter_t *inverter_1, const plant_inverter_t *inverter_2,
                     const plant_motor_t *motor_1, const plant_motor_t *motor_2, double step)
{
    const plant_inverter_t *inverter[2] = {inverter_1, inverter_2};
    const plant_motor_t *motor[2] = {motor_1, motor_2};
    for (int i = 0; i < 2; i++) {
        const plant_motor_t *m = motor[i];
        pair->pole_pairs[i] = m->pole_pairs;
        pair->inv_l_d[i] = m->inv_l_d;
        pair->inv_l_q[i] = m->inv_l_q;
        pair->r_d[i] = m->r * m->inv_l_d;
        pair->r_q[i] = m->r * m->inv_l_q;
        pair->cross_d[i] = m->pole_pairs * m->l_q * m->inv_l_d;
        pair->cross_q[i] = m->pole_pairs * m->l_d * m->inv_l_q;
        pair->emf[i] = m->pole_pairs * m->psi_m * m->inv_l_q;
        pair->torque_psi[i] = m->torque_psi * m->inv_inertia;
        pair->torque_l[i] = m->torque_l * m->inv_inertia;
        pair->viscous[i] = m->viscous * m->inv_inertia;
        pair->inv_inertia[i] = m->inv_inertia;
        pair->v_drop[i] = inverter[i]->v_drop;
        pair->r_on[i] = inverter[i]->r_on;
    }
    pair->step = step;
}
