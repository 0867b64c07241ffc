#include "plant/bridge.h"

#include <math.h>

#include "plant/decay.h"
#include "plant/inline.h"
#include "plant/trig.h"

#define STANDING 1e-9 /* slower is at rest [rad/s] */
#define THRESHOLD 1e-9 /* a torque this close to the friction, relatively, may break loose if it grows */
#define INSTANT 1e-14 /* shorter is no time at all [s] */
#define NEAR 3e-7 /* so far a moment is moved by slopes alone [s] */
#define NEVER 1e9 /* [s] */
#define SPLITS 24 /* parts of one segment; the rest of it is taken in one piece */
#define FRESH_TRIG 64u /* steps between two evaluations of sine and cosine; in between they are turned on */
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
typedef enum { WHOLE, CURRENT_ZERO, CLAMPED, STOPPED, BROKE_LOOSE } reason_t;

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

void bridge_init(bridge_t *bridge, const plant_axis_t *config)
{
    *bridge = (bridge_t){
        .v_drop = config->v_drop,
        .r_s = config->r_s,
        .r_on = config->r_on,
        .r = config->r_s + config->r_on,
        .l_d = config->l_d,
        .l_q = config->l_q,
        .inv_l_d = 1.0 / config->l_d,
        .inv_l_q = 1.0 / config->l_q,
        .psi_m = config->psi_m,
        .pole_pairs = config->pole_pairs,
        .k_torque = 1.5 * config->pole_pairs,
        .inertia = config->inertia,
        .inv_inertia = 1.0 / config->inertia,
        .friction = config->friction,
        .viscous = config->viscous,
        .tau = config->i_settle,
        .theta = config->theta_start,
    };
    const double x = (config->i_settle > 0.0) ? 1.0 / (BRIDGE_CLOCK_HZ * config->i_settle) : 800.0;
    for (int n = 0; n < BRIDGE_DECAY; n++) {
        bridge->decay_fine[n] = plant_decay(n * x);
        bridge->decay_coarse[n] = plant_decay(n * BRIDGE_DECAY * x);
    }
    plant_sincos(bridge->pole_pairs * bridge->theta, &bridge->sine, &bridge->cosine);
    bridge->psi.alpha = bridge->psi_m * bridge->cosine;
    bridge->psi.beta = bridge->psi_m * bridge->sine;
}

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

/* ---- which way the currents go ------------------------------------------------------------------------------------ */

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

/* Voltage of leg k that keeps its current at zero while the other two legs have theirs; slope of the other current. */
static double holding_voltage(const bridge_t *b, int k, double u, double *slope)
{
    const single_t single = single_of(b, k);
    const double x = single.x;
    const double w = b->pole_pairs * b->omega;
    const double next = leg_voltage(b, (k + 1) % 3, b->sign[(k + 1) % 3], u);
    const double last = leg_voltage(b, (k + 2) % 3, b->sign[(k + 2) % 3], u);
    double d;
    double q;
    const double l = inductance_across(b, single.across, b->cosine, b->sine, &d, &q);
    const double difference = b->l_d - b->l_q;
    /* across k the voltage is (next - last) / sqrt(3), along it 2/3 (v_k - their mean) */
    *slope = ((next - last) * (1.0 / PLANT_SQRT3) - b->r * x - w * q * (2.0 * difference * d * x + b->psi_m)) / l;
    /* the flux along k is q ((l_d - l_q) d x + psi_m), with d' = w q and q' = -w d */
    const double change = difference * (d * q * *slope + w * (q * q - d * d) * x) - w * d * b->psi_m;
    return 1.5 * change + 0.5 * (next + last);
}

static int pulled(double hold, double low, double high) { return (hold < low) ? 1 : (hold > high) ? -1 : 0; }

/* By how much the back-EMF exceeds what the legs block, all of them without current; and between which two [V]. The flux
 * is that of the magnet alone. */
static double excess(const bridge_t *b, double u, plant_vector_t psi, double omega, int *out, int *back)
{
    const double w = b->pole_pairs * omega;
    const double side = HALF_SQRT3 * w * psi.alpha;
    const double emf[3] = {-w * psi.beta, 0.5 * w * psi.beta + side, 0.5 * w * psi.beta - side};
    double push = lowest(b, 0, u) - emf[0];
    double pull = highest(b, 0, u) - emf[0];
    *out = *back = 0;
    for (int k = 1; k < 3; k++) {
        const double from = lowest(b, k, u) - emf[k];
        const double to = highest(b, k, u) - emf[k];
        if (from > push) {
            push = from;
            *out = k;
        }
        if (to < pull) {
            pull = to;
            *back = k;
        }
    }
    return push - pull;
}

/* Decide on the legs without current. */
static void decide(bridge_t *b, double u)
{
    int zeros = 0;
    int k = 0;
    for (int n = 0; n < 3; n++) {
        if (b->sign[n] == 0) {
            zeros++;
            k = n;
        }
    }
    if (zeros >= 2) { /* one leg alone has no way back: nothing flows yet */
        int out = 0;
        int back = 0;
        for (int n = 0; n < 3; n++) {
            set_sign(b, n, 0);
        }
        b->dead = b->unplugged || excess(b, u, b->psi, b->omega, &out, &back) <= 0.0 || out == back;
        if (b->dead) {
            return;
        }
        set_sign(b, out, 1);
        set_sign(b, back, -1);
        k = 3 - out - back;
    }
    b->hold = holding_voltage(b, k, u, &b->single_slope);
    set_sign(b, k, pulled(b->hold, lowest(b, k, u), highest(b, k, u)));
    b->floating = (b->sign[k] == 0) ? k : -1;
}

/* Of motion, from rest. */
static double break_loose(const bridge_t *b)
{
    if (b->locked || b->held) {
        return 0.0;
    }
    const double drive = b->torque - b->load;
    const double way = (drive > 0.0) ? 1.0 : -1.0;
    const double rest = drive * way - b->friction;
    return (rest > 0.0 || (rest > -THRESHOLD * b->friction && b->dtorque * way > 0.0)) ? way : 0.0;
}

void bridge_begin(bridge_t *b, double u)
{
    b->floating = -1;
    b->dead = false;
    b->begun = true;
    b->u = u;
    if (b->sign[0] == 0 || b->sign[1] == 0 || b->sign[2] == 0) {
        decide(b, u);
    }
    b->paths = leg_paths[b->gates[0]][b->sign[0] + 1] | leg_paths[b->gates[1]][b->sign[1] + 1] << 1 |
               leg_paths[b->gates[2]][b->sign[2] + 1] << 2;
    if (b->dead) {
        b->a = b->b = b->di = (plant_vector_t){0.0, 0.0};
        b->dtorque = 0.0;
    } else {
        const double drop = 2.0 * b->v_drop; /* the legs are at plus or minus half of this */
        const plant_vector_t raised = legs_at[PHASES(b->paths, RAISED(0))].v;
        b->a = legs_at[PHASES(b->paths, UPPER(0))].v;
        b->b.alpha = drop * raised.alpha;
        b->b.beta = drop * raised.beta;
        if (b->floating >= 0) { /* the tables have it at -V */
            const double more = (2.0 / 3.0) * (b->hold + b->v_drop);
            b->b.alpha += more * phase_axis[b->floating].alpha;
            b->b.beta += more * phase_axis[b->floating].beta;
        }
        const plant_vector_t dpsi = {u * b->a.alpha + b->b.alpha - b->r * b->i.alpha,
                                     u * b->a.beta + b->b.beta - b->r * b->i.beta};
        plant_vector_t di = slope_of(b, dpsi);
        if (b->floating >= 0) {
            const plant_vector_t n = phase_axis[b->floating];
            di = (plant_vector_t){-n.beta * b->single_slope, n.alpha * b->single_slope};
        }
        b->di = di;
        b->dtorque = b->k_torque * (cross(dpsi, b->i) + cross(b->psi, di));
    }
    if (b->omega > STANDING) {
        b->direction = 1.0;
    } else if (b->omega < -STANDING) {
        b->direction = -1.0;
    } else {
        b->omega = 0.0;
        b->direction = break_loose(b);
        if (b->direction == 0.0) {
            b->accel = 0.0;
            b->jerk = 0.0;
            return;
        }
    }
    b->accel = (b->torque - b->load - b->direction * b->friction - b->viscous * b->omega) * b->inv_inertia;
    b->jerk = b->dtorque * b->inv_inertia;
}

/* ---- one step ----------------------------------------------------------------------------------------------------- */

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

static void travel_out(const bridge_t *b, double h, plant_vector_t drive, end_t *e) { travel(b, h, drive, e); }

/* A step without any current. */
static void coast(const bridge_t *b, double h, end_t *e)
{
    turn(b, h, e);
    e->omega = b->omega + h * (b->accel + 0.5 * h * b->jerk);
    e->psi.alpha = b->psi_m * e->cosine;
    e->psi.beta = b->psi_m * e->sine;
    e->i = e->charge = (plant_vector_t){0.0, 0.0};
    e->phase[0] = e->phase[1] = e->phase[2] = 0.0;
    e->torque = 0.0;
}

/* The same with leg k floating: the only current is x across its axis, and no voltage of the leg acts there. Returns the
 * mean of the leg's voltage as an offset from what `drive` holds for it [V]. */
static double travel_floating(const bridge_t *b, double h, plant_vector_t drive, end_t *e)
{
    const single_t single = single_of(b, b->floating);
    const double r = b->r;
    const double third = THIRD * h;
    const double bent = 0.5 * h * b->single_slope;
    double d;
    double q;
    turn(b, h, e);
    const double per_l = 1.0 / inductance_across(b, single.across, e->cosine, e->sine, &d, &q);
    const double free = dot(single.across, b->psi) + dot(single.across, drive);
    const double guess = (free - r * h * (single.x + bent) - b->psi_m * d) * per_l;
    const double charge = third * (2.0 * single.x + bent + guess);
    const double psi_across = free - r * charge;
    const double x = (psi_across - b->psi_m * d) * per_l;
    const double psi_along = q * ((b->l_d - b->l_q) * d * x + b->psi_m);
    const plant_vector_t n = single.along;
    const plant_vector_t m = single.across;
    e->psi = (plant_vector_t){psi_across * m.alpha + psi_along * n.alpha, psi_across * m.beta + psi_along * n.beta};
    e->i = (plant_vector_t){x * m.alpha, x * m.beta};
    e->charge = (plant_vector_t){charge * m.alpha, charge * m.beta};
    e->phase[b->floating] = 0.0;
    e->phase[(b->floating + 1) % 3] = HALF_SQRT3 * x;
    e->phase[(b->floating + 2) % 3] = -HALF_SQRT3 * x;
    turned_by_torque(b, h, e);
    return 1.5 * (psi_along - dot(n, b->psi) - dot(n, drive)) / h;
}

/* A whole step, the floating leg's voltage at its end, if there is one, in `hold`. */
static void step(const bridge_t *b, double h, double u, end_t *e, double *hold)
{
    const plant_vector_t drive = {h * (u * b->a.alpha + b->b.alpha), h * (u * b->a.beta + b->b.beta)};
    if (b->dead) {
        coast(b, h, e);
    } else if (b->floating >= 0) { /* close to a straight line: the end is off by twice the mean's difference */
        *hold = b->hold + 2.0 * travel_floating(b, h, drive, e);
    } else {
        travel_out(b, h, drive, e);
    }
}

/* ---- where a step has to end early -------------------------------------------------------------------------------- */

/* First root of the parabola with f(0) = f0 >= 0, f'(0) = d0 and f(h) = f1 < 0. */
static double root_of(double f0, double d0, double f1, double h)
{
    const double c = (f1 - f0 - d0 * h) / (h * h);
    if (f0 <= 0.0) {
        return (d0 > 0.0 && c < 0.0) ? -d0 / c : 0.0;
    }
    const double square = d0 * d0 - 4.0 * c * f0;
    const double sum = ((square > 0.0) ? sqrt(square) : 0.0) - d0;
    const double t = (sum > 0.0) ? 2.0 * f0 / sum : h;
    return (t < h) ? t : h;
}

static void sooner(cut_t *cut, double after, reason_t reason, int phase, int sign)
{
    if (after <= cut->after) {
        *cut = (cut_t){after, reason, phase, sign};
    }
}

static inline bool crossed(const bridge_t *b, const end_t *e)
{
    return e->phase[0] * b->way[0] < 0.0 || e->phase[1] * b->way[1] < 0.0 || e->phase[2] * b->way[2] < 0.0;
}

/* The shaft stops, or breaks loose. */
static inline bool jerked(const bridge_t *b, const end_t *e)
{
    return e->omega * b->direction < 0.0 ||
           (b->direction == 0.0 && !b->locked && fabs(e->torque - b->load) > b->friction);
}

/* Straight on, when is the first current down to zero? */
static inline double first_zero(const bridge_t *b, double h)
{
    double slope[3];
    phases_of(b->di, slope);
    double first = h;
    for (int k = 0; k < 3; k++) {
        const double falls = -slope[k] * b->way[k];
        const double size = b->phase[k] * b->way[k];
        if (falls > 0.0 && size < falls * first) {
            first = size / falls;
        }
    }
    return (first > 0.0) ? first : 0.0;
}

static inline bool may_cross(const bridge_t *b, double h)
{
    double slope[3];
    phases_of(b->di, slope);
    return (b->phase[0] + h * slope[0]) * b->way[0] < 0.0 || (b->phase[1] + h * slope[1]) * b->way[1] < 0.0 ||
           (b->phase[2] + h * slope[2]) * b->way[2] < 0.0;
}

/* Seconds from the end of a step to the nearest zero of a current (before or after it), by the slope there. */
static double to_zero(const bridge_t *b, const end_t *e, double h, int *phase)
{
    double slope[3];
    const plant_vector_t late = {2.0 * (e->i.alpha - b->i.alpha) / h - b->di.alpha,
                                 2.0 * (e->i.beta - b->i.beta) / h - b->di.beta};
    double nearest = NEVER;
    phases_of(late, slope);
    for (int k = 0; k < 3; k++) {
        const double falls = -slope[k] * b->way[k];
        const double t = e->phase[k] * b->way[k] / falls;
        if (falls > 0.0 && t < nearest) {
            nearest = t;
            *phase = k;
        }
    }
    return nearest;
}

/* The end of a step of length h a very short time later (or earlier). */
static void shift(const bridge_t *b, double h, double t, end_t *e)
{
    const double u_alpha = (e->psi.alpha - b->psi.alpha + b->r * e->charge.alpha) / h; /* mean voltage */
    const double u_beta = (e->psi.beta - b->psi.beta + b->r * e->charge.beta) / h;
    const double x = b->pole_pairs * b->omega * t;
    const double cosine = e->cosine;
    e->theta += b->omega * t;
    e->cosine -= e->sine * x;
    e->sine += cosine * x;
    e->charge.alpha += e->i.alpha * t;
    e->charge.beta += e->i.beta * t;
    e->psi.alpha += (u_alpha - b->r * e->i.alpha) * t;
    e->psi.beta += (u_beta - b->r * e->i.beta) * t;
    e->i = current_of(b, e->psi, e->cosine, e->sine);
    phases_of(e->i, e->phase);
    e->torque = b->k_torque * cross(e->psi, e->i);
    e->omega += b->accel * t;
}

/* Moment at which the shaft stops or breaks loose. */
static void find_jerk(const bridge_t *b, double h, const end_t *e, cut_t *cut)
{
    if (e->omega * b->direction < 0.0) {
        const double way = b->direction;
        sooner(cut, root_of(b->omega * way, b->accel * way, e->omega * way, h), STOPPED, 0, 0);
    } else if (!b->held) {
        const double way = (e->torque > b->load) ? 1.0 : -1.0;
        const double rest = b->friction - (e->torque - b->load) * way;
        const double before = b->friction - (b->torque - b->load) * way;
        sooner(cut, root_of(before, -b->dtorque * way, rest, h), BROKE_LOOSE, 0, 0);
    }
}

/* A floating leg's voltage, `hold` at the end, has left its interval. */
static void find_clamp(const bridge_t *b, double h, double u, double hold, cut_t *cut)
{
    const int k = b->floating;
    const double low = lowest(b, k, u);
    const double high = highest(b, k, u);
    if (hold < low) {
        sooner(cut, h * ((b->hold > low) ? (b->hold - low) / (b->hold - hold) : 0.0), CLAMPED, k, 1);
    } else if (hold > high) {
        sooner(cut, h * ((b->hold < high) ? (high - b->hold) / (hold - b->hold) : 0.0), CLAMPED, k, -1);
    }
}

/* Without current: until the back-EMF gets through the diodes. */
static void find_conduction(const bridge_t *b, double h, double u, const end_t *e, cut_t *cut)
{
    int out = 0;
    int back = 0;
    if (b->unplugged) {
        return;
    }
    const double late = excess(b, u, e->psi, e->omega, &out, &back);
    if (late > 0.0) {
        const double early = excess(b, u, b->psi, b->omega, &out, &back);
        sooner(cut, h * ((early < 0.0) ? early / (early - late) : 0.0), CLAMPED, -1, 0);
    }
}

/* A step of at most h, ended where something changes. */
static cut_t step_to_change(const bridge_t *b, double h, double u, end_t *e)
{
    double hold = 0.0;
    double t = b->dead ? h : first_zero(b, h);
    if (t < INSTANT && t < h) { /* a current at zero that would leave it the wrong way */
        int phase = 0;
        *e = (end_t){.psi = b->psi};
        for (int k = 1; k < 3; k++) {
            phase = (b->phase[k] * b->way[k] <= 0.0 && b->way[k] != 0.0) ? k : phase;
        }
        return (cut_t){0.0, CURRENT_ZERO, phase, 0};
    }
    cut_t cut = {t, WHOLE, 0, 0};
    step(b, t, u, e, &hold);
    if (b->dead) {
        find_conduction(b, t, u, e, &cut);
    } else if (t < h || crossed(b, e)) {
        int phase = 0;
        double more = to_zero(b, e, t, &phase);
        const double near = (b->floating >= 0) ? INSTANT : NEAR; /* its shift would need the leg's voltage */
        for (int n = 0; n < 3 && fabs(more) > near && t + more < h && t + more > 0.0; n++) {
            t += more;
            step(b, t, u, e, &hold);
            more = to_zero(b, e, t, &phase);
        }
        if (t + more >= h) { /* curvature has saved it */
            t = h;
            step(b, t, u, e, &hold);
            cut.after = t;
        } else {
            more = (t + more > 0.0) ? more : 0.0;
            if (b->floating < 0) {
                shift(b, t, more, e);
                t += more;
            }
            cut = (cut_t){t, CURRENT_ZERO, phase, 0};
        }
    }
    cut_t first = {t, cut.reason, cut.phase, cut.sign};
    first.after = (cut.reason == CLAMPED) ? cut.after : t;
    if (b->floating >= 0) {
        find_clamp(b, t, u, hold, &first);
    }
    if (jerked(b, e)) {
        find_jerk(b, t, e, &first);
    }
    if (first.after < t) {
        first.after = (first.after < INSTANT) ? 0.0 : first.after;
        if (first.after > 0.0) {
            step(b, first.after, u, e, &hold);
        }
    }
    return first;
}

/* ---- moving on ---------------------------------------------------------------------------------------------------- */

static inline double decay(const bridge_t *b, double h)
{
    const unsigned n = (unsigned)(h * BRIDGE_CLOCK_HZ + 0.5);
    return (n < BRIDGE_DECAY * BRIDGE_DECAY) ? b->decay_coarse[n / BRIDGE_DECAY] * b->decay_fine[n % BRIDGE_DECAY]
                                             : 0.0;
}

/* First-order lag behind a straight line, exact. */
static inline double lag_behind(double y, double from, double to, double tau_h, double left)
{
    const double lag = tau_h * (to - from);
    return to - lag + (y - from + lag) * left;
}

/* Take over the end of a step of length h > 0. Returns the charge taken out of the bus. */
PLANT_INLINE double accept(bridge_t *b, double h, double u_h, const end_t *e)
{
    const double per_h = 1.0 / h;
    const double left = decay(b, h);
    const double tau_h = b->tau * per_h;
    for (int k = 0; k < 3; k++) {
        const double seen = (b->paths & LOWER(k)) ? 1.0 : 0.0;
        b->amplifier[k] = lag_behind(b->amplifier[k], seen * b->phase[k], seen * e->phase[k], tau_h, left);
    }
    const double charge = 1.5 * dot(b->a, e->charge);
    const double squares = (0.5 * h) * (dot(b->i, b->i) + dot(b->i, e->i) + dot(e->i, e->i)); /* 3/2 int i^2 */
    b->e_copper += b->r_s * squares;
    b->e_switch += b->r_on * squares - 1.5 * dot(b->b, e->charge);
    b->e_bus += charge * u_h * per_h;
    b->charge.alpha += e->charge.alpha;
    b->charge.beta += e->charge.beta;
    b->volt_seconds_0 += legs_at[PHASES(b->paths, UPPER(0))].mean * u_h +
                         (2.0 * legs_at[PHASES(b->paths, RAISED(0))].mean - 1.0) * b->v_drop * h;
    b->psi = e->psi;
    b->i = e->i;
    b->theta = e->theta;
    b->omega = e->omega;
    b->cosine = e->cosine;
    b->sine = e->sine;
    b->torque = e->torque;
    b->phase[0] = e->phase[0];
    b->phase[1] = e->phase[1];
    b->phase[2] = e->phase[2];
    b->begun = false;
    return charge;
}

static double accept_out(bridge_t *b, double h, double u_h, const end_t *e) { return accept(b, h, u_h, e); }

/* Take the current of phase k out of i and psi; what is left of it is the error of a root. */
static void remove_phase(bridge_t *b, int k)
{
    const double i_k = dot(b->i, phase_axis[k]);
    b->i.alpha -= i_k * phase_axis[k].alpha;
    b->i.beta -= i_k * phase_axis[k].beta;
    phases_of(b->i, b->phase);
    b->phase[k] = 0.0;
    b->phase[(k + 1) % 3] = -b->phase[(k + 2) % 3];
    const double d = b->psi_m + b->l_d * (b->i.alpha * b->cosine + b->i.beta * b->sine);
    const double q = b->l_q * (b->i.beta * b->cosine - b->i.alpha * b->sine);
    b->psi.alpha = d * b->cosine - q * b->sine;
    b->psi.beta = d * b->sine + q * b->cosine;
    b->torque = 1.5 * b->pole_pairs * cross(b->psi, b->i);
}

static void remove_all(bridge_t *b)
{
    b->i = (plant_vector_t){0.0, 0.0};
    b->psi.alpha = b->psi_m * b->cosine;
    b->psi.beta = b->psi_m * b->sine;
    b->torque = 0.0;
    for (int k = 0; k < 3; k++) {
        b->phase[k] = 0.0;
        set_sign(b, k, 0);
    }
}

/* What is different after an early end. */
static void apply(bridge_t *b, const cut_t *cut)
{
    switch (cut->reason) {
    case CURRENT_ZERO:
        set_sign(b, cut->phase, 0);
        if (b->floating >= 0) {
            remove_all(b);
        } else {
            remove_phase(b, cut->phase);
        }
        break;
    case CLAMPED:
        if (cut->phase >= 0) {
            set_sign(b, cut->phase, cut->sign);
        }
        break;
    case STOPPED:
        b->held = cut->after <= 0.0; /* it never left */
        b->omega = 0.0;
        break;
    case BROKE_LOOSE:
    case WHOLE:
        break;
    }
}

static double split_advance(bridge_t *b, double h, double u)
{
    double charge = 0.0;
    double rest = h;
    for (int n = 0; rest > INSTANT; n++) {
        end_t e;
        double hold;
        cut_t cut = {rest, WHOLE, 0, 0};
        if (!b->begun) {
            bridge_begin(b, u);
        }
        if (n < SPLITS) {
            cut = step_to_change(b, rest, u, &e);
        } else {
            step(b, rest, u, &e, &hold);
        }
        if (cut.after > 0.0) {
            charge += accept_out(b, cut.after, u * cut.after, &e);
        }
        b->begun = false;
        apply(b, &cut);
        rest -= cut.after;
    }
    b->held = false;
    return charge;
}

double bridge_advance(bridge_t *b, double h, double u_h)
{
    double charge;
    if (b->floating < 0 && !b->dead && !may_cross(b, h)) {
        end_t e;
        const plant_vector_t drive = {u_h * b->a.alpha + h * b->b.alpha, u_h * b->a.beta + h * b->b.beta};
        travel(b, h, drive, &e);
        charge = (crossed(b, &e) || jerked(b, &e)) ? split_advance(b, h, u_h / h) : accept(b, h, u_h, &e);
    } else {
        charge = split_advance(b, h, u_h / h);
    }
    if (++b->steps >= FRESH_TRIG) {
        b->steps = 0;
        plant_sincos(b->pole_pairs * b->theta, &b->sine, &b->cosine);
    }
    return charge;
}

/* ---- what others want to know ------------------------------------------------------------------------------------- */

double bridge_amplifier(const bridge_t *b, int k, double h)
{
    if (h <= 0.0) {
        return b->amplifier[k];
    }
    const double seen = (b->paths & LOWER(k)) ? 1.0 : 0.0;
    const double slope = dot(b->di, phase_axis[k]);
    return lag_behind(b->amplifier[k], seen * b->phase[k], seen * (b->phase[k] + h * slope), b->tau / h, decay(b, h));
}

double bridge_shunt(const bridge_t *b, int k) { return (b->paths & LOWER(k)) ? b->phase[k] : 0.0; }

/* Without current: true if none begins with the leg's other gates. */
static bool stays_dead(bridge_t *b, int k, bridge_gates_t gates)
{
    const bridge_gates_t before = b->gates[k];
    int out = 0;
    int back = 0;
    b->gates[k] = gates;
    const bool dead = b->unplugged || excess(b, b->u, b->psi, b->omega, &out, &back) <= 0.0;
    b->gates[k] = before;
    return dead;
}

bool bridge_indifferent(bridge_t *b, int k, bridge_gates_t gates, double h)
{
    if (b->begun && b->dead) {
        return stays_dead(b, k, gates);
    }
    if (!b->begun || b->sign[k] == 0 || leg_paths[b->gates[k]][b->sign[k] + 1] != leg_paths[gates][b->sign[k] + 1]) {
        return false;
    }
    return b->way[k] * (b->phase[k] + h * dot(b->di, phase_axis[k])) > 1e8 * h * h;
}

void bridge_set_winding(bridge_t *b, double r_s)
{
    b->r_s = r_s;
    b->r = r_s + b->r_on;
}

void bridge_plug(bridge_t *b, bool plugged)
{
    b->unplugged = !plugged;
    b->begun = false;
    if (!plugged) {
        remove_all(b);
    }
}
