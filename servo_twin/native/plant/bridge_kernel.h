/* bridge_kernel.h - what the parts of the bridge share; nobody else includes it. */
#ifndef PLANT_BRIDGE_KERNEL_H
#define PLANT_BRIDGE_KERNEL_H

#include <math.h>

#include "plant/bridge.h"
#include "plant/inline.h"
#include "plant/trig.h"

#define INSTANT 1e-14 /* shorter is no time at all [s] */
#define THIRD (1.0 / 3.0)
#define SIXTH (1.0 / 6.0)
#define HALF_SQRT3 (0.5 * PLANT_SQRT3)

/* The phases' axes in the stator frame. */
static const plant_vector_t phase_axis[3] = {{1.0, 0.0}, {-0.5, HALF_SQRT3}, {-0.5, -HALF_SQRT3}};

/* Where a step has led to. */
typedef struct {
    plant_vector_t psi, i, charge; /* charge: integral of i */
    double theta, omega, cosine, sine;
    double phase[3];
    double torque;
} end_t;

/* Why a step ends early. */
typedef enum { WHOLE, CURRENT_ZERO, CLAMPED, STOPPED, BROKE_LOOSE, ENDED } reason_t;

typedef struct {
    double after; /* [s] */
    reason_t reason;
    int phase, sign;
} cut_t;

/* Ways through a leg, one bit per phase: from the positive rail; with the drop counting upwards (current out of the
 * motor); through the shunt. */
#define UPPER(k) (1u << (k))
#define RAISED(k) (8u << (k))
#define LOWER(k) (64u << (k))
#define PHASES(paths, bit0) (((paths) / (bit0)) & 7u)

/* For one phase, by gates and sign of the current + 1, to be shifted by the number of the phase. */
static const unsigned leg_paths[BRIDGE_GATES][3] = {
    [BRIDGE_OPEN] = {UPPER(0) | RAISED(0), 0, LOWER(0)},
    [BRIDGE_HIGH] = {UPPER(0) | RAISED(0), 0, UPPER(0)},
    [BRIDGE_LOW] = {LOWER(0) | RAISED(0), LOWER(0), LOWER(0)},
};

/* Clarke transform and mean of legs that are at 1 (bit set) or 0. */
static const struct {
    plant_vector_t v;
    double mean;
} legs_at[8] = {
    {{0.0, 0.0}, 0.0},
    {{2.0 * THIRD, 0.0}, THIRD},
    {{-THIRD, 1.0 / PLANT_SQRT3}, THIRD},
    {{THIRD, 1.0 / PLANT_SQRT3}, 2.0 * THIRD},
    {{-THIRD, -1.0 / PLANT_SQRT3}, THIRD},
    {{THIRD, -1.0 / PLANT_SQRT3}, 2.0 * THIRD},
    {{-2.0 * THIRD, 0.0}, 2.0 * THIRD},
    {{0.0, 0.0}, 1.0},
};

/* ---- small pieces ------------------------------------------------------------------------------------------------- */

static inline double dot(plant_vector_t x, plant_vector_t y) { return x.alpha * y.alpha + x.beta * y.beta; }

static inline double cross(plant_vector_t x, plant_vector_t y) { return x.alpha * y.beta - x.beta * y.alpha; }

/* Currents that belong to a flux at the rotor angle of cosine and sine. */
static inline plant_vector_t current_of(const bridge_t *b, plant_vector_t psi, double c, double s)
{
    const double d = (psi.alpha * c + psi.beta * s - b->psi_m) * b->inv_l_d;
    const double q = (psi.beta * c - psi.alpha * s) * b->inv_l_q;
    return (plant_vector_t){d * c - q * s, d * s + q * c};
}

static inline void phases_of(plant_vector_t i, double phase[3])
{
    const double half = -0.5 * i.alpha;
    const double side = HALF_SQRT3 * i.beta;
    phase[0] = i.alpha;
    phase[1] = half + side;
    phase[2] = half - side;
}

/* Change of a vector that stands still in the rotor, by L^-1: the inverse inductance in the stator frame. */
static inline plant_vector_t per_inductance(const bridge_t *b, plant_vector_t v)
{
    const double d = (v.alpha * b->cosine + v.beta * b->sine) * b->inv_l_d;
    const double q = (v.beta * b->cosine - v.alpha * b->sine) * b->inv_l_q;
    return (plant_vector_t){d * b->cosine - q * b->sine, d * b->sine + q * b->cosine};
}

/* di/dt at the beginning of a segment where the flux changes by dpsi: i' = L^-1 (psi' - j w psi) + j w i, from
 * d/dt of e^{j theta} L^-1 (e^{-j theta} psi - psi_m). */
static inline plant_vector_t slope_of(const bridge_t *b, plant_vector_t dpsi)
{
    const double w = b->pole_pairs * b->omega;
    const plant_vector_t drive = {dpsi.alpha + w * b->psi.beta, dpsi.beta - w * b->psi.alpha};
    const plant_vector_t rate = per_inductance(b, drive);
    return (plant_vector_t){rate.alpha - w * b->i.beta, rate.beta + w * b->i.alpha};
}

/* Voltage of a leg whose current has the given sign. */
static inline double leg_voltage(const bridge_t *b, int k, int sign, double u)
{
    const unsigned path = leg_paths[b->gates[k]][sign + 1];
    return ((path & UPPER(0)) ? u : 0.0) + ((path & RAISED(0)) ? b->v_drop : -b->v_drop);
}

static inline double lowest(const bridge_t *b, int k, double u) { return leg_voltage(b, k, 1, u); }

static inline double highest(const bridge_t *b, int k, double u) { return leg_voltage(b, k, -1, u); }

static inline void set_sign(bridge_t *b, int k, int sign)
{
    b->sign[k] = sign;
    b->way[k] = sign;
}

/* ---- one plain step ---------------------------------------------------------------------------------------------- */

/* The shaft, and the rotor's angle with it. */
PLANT_INLINE void turn(const bridge_t *b, double h, end_t *e)
{
    const double way = h * (b->omega + h * (0.5 * b->accel + (SIXTH * h) * b->jerk));
    const double x = b->pole_pairs * way;
    const double x2 = x * x;
    const double c = 1.0 - x2 * (0.5 - x2 * ((1.0 / 24.0) - x2 * (1.0 / 720.0)));
    const double s = x * (1.0 - x2 * (SIXTH - x2 * (1.0 / 120.0)));
    e->theta = b->theta + way;
    e->cosine = b->cosine * c - b->sine * s;
    e->sine = b->sine * c + b->cosine * s;
}

/* Speed at the end, once the currents are known there. */
PLANT_INLINE void turned_by_torque(const bridge_t *b, double h, end_t *e)
{
    e->torque = b->k_torque * cross(e->psi, e->i);
    const double impulse = (THIRD * h) * (2.0 * b->torque + (0.5 * h) * b->dtorque + e->torque);
    const double drag = h * (b->load + b->direction * b->friction) + b->viscous * (e->theta - b->theta);
    e->omega = (b->direction != 0.0) ? b->omega + (impulse - drag) * b->inv_inertia : 0.0;
}

/* A step with the integral `drive` of the legs' voltage. */
PLANT_INLINE void travel(const bridge_t *b, double h, plant_vector_t drive, end_t *e)
{
    const double r = b->r;
    const double half = 0.5 * h;
    const double third = THIRD * h;
    turn(b, h, e);
    const plant_vector_t bent = {half * b->di.alpha, half * b->di.beta};
    const plant_vector_t free = {b->psi.alpha + drive.alpha, b->psi.beta + drive.beta};
    const plant_vector_t guess = {free.alpha - r * h * (b->i.alpha + bent.alpha),
                                  free.beta - r * h * (b->i.beta + bent.beta)};
    const plant_vector_t i_guess = current_of(b, guess, e->cosine, e->sine);
    e->charge.alpha = third * (2.0 * b->i.alpha + bent.alpha + i_guess.alpha);
    e->charge.beta = third * (2.0 * b->i.beta + bent.beta + i_guess.beta);
    e->psi.alpha = free.alpha - r * e->charge.alpha;
    e->psi.beta = free.beta - r * e->charge.beta;
    e->i = current_of(b, e->psi, e->cosine, e->sine);
    phases_of(e->i, e->phase);
    turned_by_torque(b, h, e);
}

static inline bool crossed(const bridge_t *b, const end_t *e)
{
    return e->phase[0] * b->way[0] < 0.0 || e->phase[1] * b->way[1] < 0.0 || e->phase[2] * b->way[2] < 0.0;
}

/* An end stop lets a resting shaft go one way only. */
static inline bool open_way(const bridge_t *b, double way)
{
    return (way > 0.0) ? b->theta < b->high : b->theta > b->low;
}

/* The shaft stops, breaks loose, or has come to an end stop. */
static inline bool jerked(const bridge_t *b, const end_t *e)
{
    return e->omega * b->direction < 0.0 || e->theta > b->high || e->theta < b->low ||
           (b->direction == 0.0 && !b->locked && fabs(e->torque - b->load) > b->friction &&
            open_way(b, e->torque - b->load));
}

static inline bool may_cross(const bridge_t *b, double h)
{
    double slope[3];
    phases_of(b->di, slope);
    return (b->phase[0] + h * slope[0]) * b->way[0] < 0.0 || (b->phase[1] + h * slope[1]) * b->way[1] < 0.0 ||
           (b->phase[2] + h * slope[2]) * b->way[2] < 0.0;
}

/* A leg without current leaves one winding current: x along the direction across the leg's axis. What the flux along
 * the leg's own axis is then, and how it changes, needs the rotor's direction as seen from there. */
typedef struct {
    plant_vector_t along, across;
    double x;
} single_t;

static inline single_t single_of(const bridge_t *b, int k)
{
    const plant_vector_t n = phase_axis[k];
    const plant_vector_t m = {-n.beta, n.alpha};
    return (single_t){n, m, dot(m, b->i)};
}

/* Inductance across, and flux of the leg's axis, for the rotor at cosine and sine. */
static inline double inductance_across(const bridge_t *b, plant_vector_t m, double c, double s, double *d, double *q)
{
    *d = m.alpha * c + m.beta * s;
    *q = m.beta * c - m.alpha * s;
    return b->l_d * *d * *d + b->l_q * *q * *q;
}

/* ---- parts in other files ------------------------------------------------------------------------------------------- */

/* bridge_legs.c: by how much the back-EMF exceeds what the legs block, all of them without current; and between which
 * two [V]. The flux is that of the magnet alone. */
double bridge_excess(const bridge_t *bridge, double u, plant_vector_t psi, double omega, int *out, int *back);

/* bridge_step.c: a whole step, whatever happens in it; what it is in, the floating leg's voltage at its end. */
void bridge_step(const bridge_t *bridge, double h, double u, end_t *end, double *hold);

/* A step of at most h, ended where something changes. */
cut_t bridge_step_to_change(const bridge_t *bridge, double h, double u, end_t *end);

#endif
