#include "plant/motor_pair.h"

#include <math.h>
#include <string.h>

#include "plant/trig.h"

#if defined(__GNUC__) && !defined(PLANT_GENERAL)

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

/* True for a driven axis that is expected to rotate or to stand during the whole step; *direction becomes that of motion, 0:
 * standstill. */
static bool is_regular(const motor_lane_t *lane, double *direction)
{
    plant_motor_t *motor = lane->motor;
    *direction = 0.0;
    if (!lane->inverter->on || lane->inverter->unplugged || lane->inverter->has_fault || motor->single) {
        return false;
    }
    if (fabs(motor->omega) > PLANT_STANDING) {
        *direction = copysign(1.0, motor->omega);
        return true;
    }
    if (motor->locked) {
        return true;
    }
    const double drive = plant_motor_torque(motor) - motor->load;
    if (drive > motor->friction || drive < -motor->friction) {
        return false;
    }
    motor->omega = 0.0;
    return true;
}

/* End of a step, before the axes take it over; names and units as in plant_motor_t and averaged_inverter_t, charge [A s]. */
typedef struct {
    pair_state_t x;
    pair_t theta, sine, cosine;
    pair_t phase[3], share[3], leg[3], charge, heat;
} ends_t;

static inline void take_over(const ends_t *ends, const motor_lane_t *lane, int n)
{
    plant_motor_t *motor = lane->motor;
    motor->i_d = ends->x.i_d[n];
    motor->i_q = ends->x.i_q[n];
    motor->omega = ends->x.omega[n];
    motor->theta = ends->theta[n];
    motor->sine = ends->sine[n];
    motor->cosine = ends->cosine[n];
    for (int k = 0; k < 3; k++) {
        motor->phase[k] = ends->phase[k][n];
        lane->inverter->share[k] = ends->share[k][n];
        lane->inverter->leg[k] = ends->leg[k][n];
    }
    lane->inverter->heat += ends->heat[n];
    plant_motor_count_step(motor);
}

#define MOTOR(member) ((pair_t){lane[0].motor->member, lane[1].motor->member})
#define INVERTER(member) ((pair_t){lane[0].inverter->member, lane[1].inverter->member})

unsigned motor_pair_step(const motor_pair_t *pair, const motor_lane_t lane[2], double u_dc, double *charge)
{
    double directions[2];
    const bool regular[2] = {is_regular(&lane[0], &directions[0]), is_regular(&lane[1], &directions[1])};
    *charge = 0.0;
    if (!regular[0] && !regular[1]) {
        return 0;
    }
    ends_t ends;
    const pair_t before[3] = {MOTOR(phase[0]), MOTOR(phase[1]), MOTOR(phase[2])};
    const pair_t v_drop = pair_of(pair->v_drop);
    const pair_t inv_i_w = INVERTER(inv_i_w);
    for (int k = 0; k < 3; k++) {
        ends.share[k] =
            pair_drive_leg(before[k], inv_i_w, INVERTER(duty[k]), INVERTER(dead_leg[k]), v_drop, u_dc, &ends.leg[k]);
    }
    const pair_t omega = MOTOR(omega);
    /* not through memory: a load of both lanes would stall on the two stores */
    const pair_t direction = {directions[0], directions[1]};
    const pair_t moves = direction * direction; /* 0 at standstill, where there is no acceleration */
    const pair_step_t m = {
        .angle = pair_of(pair->angle),
        .inv_l_d = pair_of(pair->inv_l_d),
        .inv_l_q = pair_of(pair->inv_l_q),
        .r_d = pair_of(pair->r_d),
        .r_q = pair_of(pair->r_q),
        .cross_d = pair_of(pair->cross_d),
        .cross_q = pair_of(pair->cross_q),
        .emf = pair_of(pair->emf),
        .torque_psi = moves * pair_of(pair->torque_psi),
        .torque_l = moves * pair_of(pair->torque_l),
        .viscous = pair_of(pair->viscous),
        .drag = (moves * MOTOR(load) + direction * MOTOR(friction)) * pair_of(pair->per_j),
    };
    const pair_t sine = MOTOR(sine);
    const pair_t cosine = MOTOR(cosine);
    const pair_t alpha = (2.0 * ends.leg[0] - ends.leg[1] - ends.leg[2]) * (1.0 / 3.0);
    const pair_t beta = (ends.leg[1] - ends.leg[2]) * 0.57735026918962576451;
    const pair_vector_t u = {alpha * cosine + beta * sine, beta * cosine - alpha * sine};
    pair_vector_t e;
    ends.x = (pair_state_t){MOTOR(i_d), MOTOR(i_q), omega};
    ends.theta = MOTOR(theta) + pair_runge_kutta(&m, u, pair->step, &ends.x, &e);
    ends.cosine = cosine * e.alpha - sine * e.beta;
    ends.sine = sine * e.alpha + cosine * e.beta;
    pair_phases(ends.x.i_d, ends.x.i_q, ends.sine, ends.cosine, ends.phase);
    pair_t charge_twice = both(0.0);
    pair_t loss = both(0.0);
    for (int k = 0; k < 3; k++) {
        charge_twice += ends.share[k] * (before[k] + ends.phase[k]);
        loss += pair_leg_loss(before[k], ends.phase[k], ends.share[k], ends.leg[k], pair_of(pair->r_on), u_dc);
    }
    ends.heat = loss * pair->step;
    ends.charge = charge_twice * (0.5 * pair->step);
    const pair_t onwards = ends.x.omega * direction;
    unsigned taken = 0;
    if (regular[0] && onwards[0] >= 0.0) {
        take_over(&ends, &lane[0], 0);
        *charge += ends.charge[0];
        taken |= 1u;
    }
    if (regular[1] && onwards[1] >= 0.0) {
        take_over(&ends, &lane[1], 1);
        *charge += ends.charge[1];
        taken |= 2u;
    }
    return taken;
}

#else

unsigned motor_pair_step(const motor_pair_t *pair, const motor_lane_t lane[2], double u_dc, double *charge)
{
    (void)pair;
    (void)lane;
    (void)u_dc;
    *charge = 0.0;
    return 0;
}

#endif

void motor_pair_init(motor_pair_t *pair, const motor_lane_t lane[2], double step)
{
    for (int i = 0; i < 2; i++) {
        const plant_motor_t *m = lane[i].motor;
        const double per_l_d = 0.5 * step * m->inv_l_d;
        const double per_l_q = 0.5 * step * m->inv_l_q;
        const double per_j = 0.5 * step * m->inv_inertia;
        pair->angle[i] = 0.5 * step * m->pole_pairs;
        pair->inv_l_d[i] = per_l_d;
        pair->inv_l_q[i] = per_l_q;
        pair->r_d[i] = m->r * per_l_d;
        pair->r_q[i] = m->r * per_l_q;
        pair->cross_d[i] = m->pole_pairs * m->l_q * per_l_d;
        pair->cross_q[i] = m->pole_pairs * m->l_d * per_l_q;
        pair->emf[i] = m->pole_pairs * m->psi_m * per_l_q;
        pair->torque_psi[i] = m->torque_psi * per_j;
        pair->torque_l[i] = m->torque_l * per_j;
        pair->viscous[i] = m->viscous * per_j;
        pair->per_j[i] = per_j;
        pair->v_drop[i] = lane[i].inverter->v_drop;
        pair->r_on[i] = lane[i].inverter->r_on;
    }
    pair->step = step;
}
