/* bridge_kernel.h - what the parts of the bridge share; nobody else includes it. */
#ifndef PLANT_BRIDGE_KERNEL_H
#define PLANT_BRIDGE_KERNEL_H

#include <math.h>

#include "plant/bridge.h"
#include "plant/inline.h"
#include "plant/trig.h"

#define INSTANT 1e-14 /* shorter is no time at all [s] */
#define NOTHING 1e-12 /* a current that a rounding has left [A] */
#define THIRD (1.0 / 3.0)
#define SIXTH (1.0 / 6.0)
#define HALF_SQRT3 (0.5 * PLANT_SQRT3)

/* The phases' axes in the stator frame. */
static const plant_vector_t phase_axis[3] = {{1.0, 0.0}, {-0.5, HALF_SQRT3}, {-0.5, -HALF_SQRT3}};

/* Where a step has led to. */
typedef struct {
    plant_vector_t psi, i, charge; /* charge: integral of i */
    double theta, omega, cosine, sine;
    bridge_matrix_t inverse;
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

#define LEG_A BRIDGE_LEG(0)
#define LEG_B BRIDGE_LEG(1)
#define LEG_C BRIDGE_LEG(2)

/* Clarke transform and mean of legs that are at 1 (bit set) or 0. */
static const double legs_at[BRIDGE_LEG_SETS][BRIDGE_LANES] PLANT_VECTORS = {
    [LEG_A] = {2.0 * THIRD, 0.0, THIRD},
    [LEG_B] = {-THIRD, 1.0 / PLANT_SQRT3, THIRD},
    [LEG_A | LEG_B] = {THIRD, 1.0 / PLANT_SQRT3, 2.0 * THIRD},
    [LEG_C] = {-THIRD, -1.0 / PLANT_SQRT3, THIRD},
    [LEG_A | LEG_C] = {THIRD, -1.0 / PLANT_SQRT3, 2.0 * THIRD},
    [LEG_B | LEG_C] = {-2.0 * THIRD, 0.0, 2.0 * THIRD},
    [BRIDGE_LEGS] = {0.0, 0.0, 1.0},
};
enum { LEGS_ALPHA, LEGS_BETA, LEGS_MEAN };

/* ---- small pieces ------------------------------------------------------------------------------------------------- */

static inline double dot(plant_vector_t x, plant_vector_t y) { return x.alpha * y.alpha + x.beta * y.beta; }

static inline double cross(plant_vector_t x, plant_vector_t y) { return x.alpha * y.beta - x.beta * y.alpha; }

static inline plant_vector_t times(bridge_matrix_t m, plant_vector_t x)
{
    return (plant_vector_t){m.aa * x.alpha + m.ab * x.beta, m.ab * x.alpha + m.bb * x.beta};
}

/* Inverse inductance seen from the stator, for the rotor at cosine and sine. */
static inline bridge_matrix_t inverse_of(const bridge_t *b, double c, double s)
{
    const double along = b->inv_l_half * (c * c - s * s);
    return (bridge_matrix_t){b->inv_l_mean + along, 2.0 * b->inv_l_half * c * s, b->inv_l_mean - along};
}

static inline saturation_t iron_d(const bridge_t *b) { return (saturation_t){b->l_d, b->per_s_d}; }

static inline saturation_t iron_q(const bridge_t *b) { return (saturation_t){b->l_q, b->per_s_q}; }

/* bridge.c: currents of saturated iron. */
plant_vector_t bridge_iron_current(const bridge_t *bridge, plant_vector_t psi, double c, double s);

/* Currents that belong to a flux at the rotor angle of cosine and sine. */
static inline plant_vector_t current_of(const bridge_t *b, bridge_matrix_t inverse, plant_vector_t psi, double c,
                                        double s)
{
    if (b->saturates) {
        return bridge_iron_current(b, psi, c, s);
    }
    return times(inverse, (plant_vector_t){psi.alpha - b->psi_m * c, psi.beta - b->psi_m * s});
}

static inline void phases_of(plant_vector_t i, double phase[3])
{
    const double half = -0.5 * i.alpha;
    const double side = HALF_SQRT3 * i.beta;
    phase[0] = i.alpha;
    phase[1] = half + side;
    phase[2] = half - side;
}

/* di/dt at the beginning of a segment where the flux changes by dpsi: i' = L^-1 (psi' - j w psi) + j w i, from
 * d/dt of e^{j theta} L^-1 (e^{-j theta} psi - psi_m). */
static inline plant_vector_t slope_of(const bridge_t *b, plant_vector_t dpsi)
{
    const double w = b->pole_pairs * b->omega;
    const plant_vector_t drive = {dpsi.alpha + w * b->psi.beta, dpsi.beta - w * b->psi.alpha};
    const plant_vector_t rate = times(b->inverse, drive);
    return (plant_vector_t){rate.alpha - w * b->i.beta, rate.beta + w * b->i.alpha};
}

/* Of the current of a leg. */
static inline int sign_of(const bridge_t *b, int k)
{
    return (int)(b->positive >> BRIDGE_LANE(k) & 1u) - (int)(b->negative >> BRIDGE_LANE(k) & 1u);
}

/* Lower gates that are on. */
static inline unsigned lower_of(const bridge_t *b) { return b->gates >> BRIDGE_LOWER; }

/* Legs that are at the positive rail. What is said of one without current makes no difference, here and below. */
static inline unsigned from_upper(const bridge_t *b) { return (b->negative & ~lower_of(b)) | (b->positive & b->gates); }

/* Ways through legs that stand for themselves, by their gates and signs. */
static inline bridge_paths_t own_paths(const bridge_t *b)
{
    const unsigned upper = from_upper(b) & b->own;
    return (bridge_paths_t){.upper = upper, .raised = b->negative & b->own, .lower = b->own & ~upper};
}

/* Way through two legs that touch each other, by the sign of what both give together. Those that are not switched alike
 * are taken for open: where they fight, the comparator has the last word. */
static inline bridge_paths_t joint_paths(const bridge_t *b, int sign)
{
    const unsigned joint = b->joint;
    const bool from_upper = (sign < 0) ? (lower_of(b) & joint) != joint : (b->gates & joint) == joint;
    return (bridge_paths_t){
        .upper = from_upper ? joint : 0u, .raised = (sign < 0) ? joint : 0u, .lower = from_upper ? 0u : joint};
}

static inline double path_voltage(const bridge_t *b, bridge_paths_t paths, double u)
{
    return ((paths.upper != 0u) ? u : 0.0) + ((paths.raised != 0u) ? b->v_drop : -b->v_drop);
}

/* Ends of the interval of a leg that touches nothing. A product, as no processor can guess which gate is on. */
static inline double low_end(const bridge_t *b, int k, double u)
{
    return u * (double)(int)(b->gates >> BRIDGE_LANE(k) & 1u) - b->reach[k];
}

static inline double high_end(const bridge_t *b, int k, double u)
{
    return u * (double)(int)(~lower_of(b) >> BRIDGE_LANE(k) & 1u) + b->reach[k];
}

/* The same for any leg. That of one beside two that touch is as seen from these, which are taken to be at -V. */
static inline double lowest(const bridge_t *b, int k, double u)
{
    const double low = (k == b->grounded) ? 0.0 : low_end(b, k, u);
    return (k == b->alone) ? low - path_voltage(b, joint_paths(b, -1), u) - b->v_drop : low;
}

static inline double highest(const bridge_t *b, int k, double u)
{
    const double high = (k == b->grounded) ? 0.0 : high_end(b, k, u);
    return (k == b->alone) ? high - path_voltage(b, joint_paths(b, 1), u) - b->v_drop : high;
}

static inline void set_sign(bridge_t *b, int k, int sign)
{
    const unsigned leg = BRIDGE_LEG(k) & ~b->joint;
    b->positive = (b->positive & ~leg) | ((sign > 0) ? leg : 0u);
    b->negative = (b->negative & ~leg) | ((sign < 0) ? leg : 0u);
}

/* First-order lag behind a straight line, exact. */
static inline double lag_behind(double y, double from, double to, double tau_h, double left)
{
    const double lag = tau_h * (to - from);
    return to - lag + (y - from + lag) * left;
}

/* How much the currents may bend at this speed. */
static inline void find_bend(bridge_t *b)
{
    const double w = fabs(b->pole_pairs * b->omega);
    b->k_most = b->r * b->inv_l_most + w * (1.0 + b->saliency);
    b->push_most = w * w * b->psi_m * b->inv_l_most;
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
    e->inverse = inverse_of(b, e->cosine, e->sine);
}

/* Speed at the end, once the currents are known there. */
PLANT_INLINE void turned_by_torque(const bridge_t *b, double h, end_t *e)
{
    e->torque = b->k_torque * cross(e->psi, e->i);
    const double impulse = (THIRD * h) * (2.0 * b->torque + (0.5 * h) * b->dtorque + e->torque);
    const double drag = h * (b->load + b->direction * b->friction) + b->viscous * (e->theta - b->theta);
    e->omega = (b->direction != 0.0) ? b->omega + (impulse - drag) * b->inv_inertia : 0.0;
}

/* Charge and end of a step with the integral `drive` of the legs' voltage: first with a current that is straight, then with
 * its bend, which changes flux and current in proportion. */
PLANT_INLINE void straight_on(const bridge_t *b, double h, plant_vector_t drive, end_t *e)
{
    e->charge = (plant_vector_t){h * (b->i.alpha + (0.5 * h) * b->di.alpha), h * (b->i.beta + (0.5 * h) * b->di.beta)};
    e->psi.alpha = b->psi.alpha + drive.alpha - b->r * e->charge.alpha;
    e->psi.beta = b->psi.beta + drive.beta - b->r * e->charge.beta;
    e->i = current_of(b, e->inverse, e->psi, e->cosine, e->sine);
}

PLANT_INLINE void bend(const bridge_t *b, double h, end_t *e)
{
    const double third = THIRD * h;
    const plant_vector_t more = {third * (e->i.alpha - b->i.alpha - h * b->di.alpha),
                                 third * (e->i.beta - b->i.beta - h * b->di.beta)};
    const plant_vector_t lost = {b->r * more.alpha, b->r * more.beta};
    const plant_vector_t less = times(e->inverse, lost);
    e->charge.alpha += more.alpha;
    e->charge.beta += more.beta;
    e->psi.alpha -= lost.alpha;
    e->psi.beta -= lost.beta;
    e->i.alpha -= less.alpha;
    e->i.beta -= less.beta;
}

PLANT_INLINE void travel(const bridge_t *b, double h, plant_vector_t drive, end_t *e)
{
    turn(b, h, e);
    straight_on(b, h, drive, e);
    bend(b, h, e);
    phases_of(e->i, e->phase);
    turned_by_torque(b, h, e);
}

/* Take the current out of the axis `n`, whose voltage is free to do so; returns the voltage's integral. */
PLANT_INLINE double hold_at_zero(plant_vector_t n, plant_vector_t per_n, double per_l, end_t *e)
{
    const double lift = -dot(n, e->i) * per_l;
    e->i.alpha += lift * per_n.alpha;
    e->i.beta += lift * per_n.beta;
    e->psi.alpha += lift * n.alpha;
    e->psi.beta += lift * n.beta;
    return lift;
}

/* The same with one leg floating. Returns the mean of its voltage as an offset from what `drive` holds for it [V]. */
PLANT_INLINE double travel_floating(const bridge_t *b, double h, plant_vector_t drive, end_t *e)
{
    const int k = b->floating;
    const plant_vector_t n = phase_axis[k];
    turn(b, h, e);
    const plant_vector_t per_n = times(e->inverse, n);
    const double per_l = 1.0 / dot(n, per_n);
    straight_on(b, h, drive, e);
    double lift = hold_at_zero(n, per_n, per_l, e);
    bend(b, h, e);
    lift += hold_at_zero(n, per_n, per_l, e);
    phases_of(e->i, e->phase);
    e->phase[k] = 0.0;
    e->phase[(k + 1) % 3] = -e->phase[(k + 2) % 3];
    turned_by_torque(b, h, e);
    return 1.5 * lift / h;
}

static inline bool crossed(const bridge_t *b, const end_t *e)
{
    return e->phase[0] * sign_of(b, 0) < -NOTHING || e->phase[1] * sign_of(b, 1) < -NOTHING ||
           e->phase[2] * sign_of(b, 2) < -NOTHING;
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

/* First root within h of the parabola f0 + d0 t + c t^2 with f0 >= 0 and f(h) < 0. What is below zero by rounding alone
 * counts as zero: it comes back there when it likes, so this root, too, ends with h. */
static inline double root_within(double f0, double d0, double c, double h)
{
    double t;
    if (f0 <= 0.0) {
        t = (d0 > 0.0 && c < 0.0) ? -d0 / c : 0.0;
    } else {
        const double square = d0 * d0 - 4.0 * c * f0;
        const double sum = ((square > 0.0) ? sqrt(square) : 0.0) - d0;
        t = (sum > 0.0) ? 2.0 * f0 / sum : h;
    }
    return (t < h) ? t : h;
}

/* The same by f(h) = f1. */
static inline double root_of(double f0, double d0, double f1, double h)
{
    return root_within(f0, d0, (f1 - f0 - d0 * h) / (h * h), h);
}

/* ---- parts in other files ------------------------------------------------------------------------------------------- */

/* bridge_legs.c: by how much the back-EMF exceeds what the legs block, all of them without current; and between which
 * two [V]. The flux is that of the magnet alone. */
double bridge_excess(const bridge_t *bridge, double u, plant_vector_t psi, double omega, int *out, int *back);

/* bridge_step.c: a whole step, whatever happens in it; what it is in, the floating leg's voltage at its end. */
void bridge_step(const bridge_t *bridge, double h, double u, end_t *end, double *hold);

/* A step of at most h, ended where something changes. */
cut_t bridge_step_to_change(const bridge_t *bridge, double h, double u, end_t *end);

/* The end of a step of length h a very short time later (or earlier). */
void bridge_shift(const bridge_t *bridge, double h, double t, end_t *end);

/* bridge.c: take over the end of a step of length h > 0. Returns the charge taken out of the bus. */
double bridge_accept(bridge_t *bridge, double h, double u_h, const end_t *end);

/* Sine and cosine have been turned on; now and then they are made afresh. */
void bridge_count_turn(bridge_t *bridge);

/* Take the current of phase k out of i and psi; what is left of it is the error of a root. */
void bridge_remove_phase(bridge_t *bridge, int k);

/* Take away what is left of all currents. */
void bridge_remove_all(bridge_t *bridge);

/* bridge_legs.c: two legs or more without current: one leg alone has no way back, so nothing flows unless the back-EMF is
 * above the bus. Returns the leg that is left without current then, -1 if that is all of them. */
int bridge_leave_one(bridge_t *bridge, double u);

/* Begin a segment of which everything is computed anew. */
void bridge_begin_anew(bridge_t *bridge, double u);

/* bridge_frame.c: make a frame, if nothing forbids it. */
bool bridge_frame(bridge_t *bridge, double u);

/* Begin a segment of the frame. */
void bridge_frame_begin(bridge_t *bridge, double u);

/* Up to `rest` seconds as far as nothing unusual happens; `rest` becomes what is left. Returns the charge taken out of the
 * bus. */
double bridge_frame_advance(bridge_t *bridge, double *rest, double u);

/* What the amplifiers show `h` seconds into a segment of the frame; false if something changes before. */
bool bridge_foresee(const bridge_t *bridge, double h, double shown[BRIDGE_LANES]);

/* bridge_legs.c: the only leg without current, -1 if there is none, NO_CURRENT if there are more. */
#define NO_CURRENT 3
static inline int leg_at_zero(const bridge_t *b)
{
    static const int8_t leg[BRIDGE_LEG_SETS] = {
        NO_CURRENT, NO_CURRENT, NO_CURRENT, NO_CURRENT, NO_CURRENT, 2, NO_CURRENT,
        NO_CURRENT, NO_CURRENT, 1,          NO_CURRENT, NO_CURRENT, 0, -1,
    };
    return leg[b->positive | b->negative | b->joint];
}

/* Leg k, at -V so far, goes to the voltage inside its interval that keeps its current at zero, `needed` higher, or as near to
 * it as it can. Returns how far it has gone up [V]. */
static inline double settle_leg(bridge_t *b, int k, double low, double high, double needed)
{
    const double hold = needed - b->v_drop;
    b->hold = hold;
    double voltage = hold;
    b->floating = -1;
    if (hold < low) {
        set_sign(b, k, 1);
        voltage = low;
    } else if (hold > high) {
        set_sign(b, k, -1);
        voltage = high;
    } else {
        b->floating = k;
    }
    return voltage + b->v_drop;
}

/* What conducts. Without current through two legs that touch each other any way will do, -V is what others expect. */
static inline bridge_paths_t paths_of(const bridge_t *b)
{
    bridge_paths_t paths = own_paths(b);
    const int sign = (b->alone >= 0) ? sign_of(b, b->alone) : 0;
    if (sign != 0) {
        const bridge_paths_t joint = joint_paths(b, -sign);
        paths.upper |= joint.upper;
        paths.raised |= joint.raised;
        paths.lower |= joint.lower;
    }
    return paths;
}

/* What conducts, and the vectors that belong to it. */
static inline void find_paths(bridge_t *b)
{
    b->paths = paths_of(b);
    const double *upper = legs_at[b->paths.upper];
    const double *drops = b->drops[b->paths.raised];
    b->a = (plant_vector_t){upper[LEGS_ALPHA], upper[LEGS_BETA]};
    b->b = (plant_vector_t){drops[LEGS_ALPHA], drops[LEGS_BETA]};
    b->level = b->u * upper[LEGS_MEAN] + drops[LEGS_MEAN];
    if (b->grounded >= 0 && sign_of(b, b->grounded) != 0) { /* it is there, and not one drop below */
        const double *lift = legs_at[BRIDGE_LEG(b->grounded)];
        b->b.alpha += b->v_drop * lift[LEGS_ALPHA];
        b->b.beta += b->v_drop * lift[LEGS_BETA];
        b->level += b->v_drop * lift[LEGS_MEAN];
    }
}

/* Of the amplifiers in h seconds. */
static inline double decay(const bridge_t *b, double h)
{
    const unsigned n = (unsigned)(int)(h * BRIDGE_CLOCK_HZ + 0.5);
    const unsigned coarse = n / BRIDGE_DECAY;
    return b->decay_coarse[(coarse < BRIDGE_DECAY) ? coarse : BRIDGE_DECAY] * b->decay_fine[n % BRIDGE_DECAY];
}

#endif
