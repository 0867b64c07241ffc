#include "plant/bridge.h"

#include <math.h>

#include "plant/decay.h"
#include "plant/inline.h"
#include "plant/trig.h"

#define STANDING 1e-9 /* slower is at rest [rad/s] */
#define THRESHOLD 1e-9 /* a torque this close to the friction, relatively, may break loose if it grows */
#define INSTANT 1e-14 /* shorter is no time at all [s] */
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

/* Slope of a phase current per volt on its own leg. */
static double admittance(const bridge_t *b, int k)
{
    return (2.0 / 3.0) * dot(phase_axis[k], per_inductance(b, phase_axis[k]));
}

/* Voltage of leg k that keeps its current at zero while the other two legs have theirs. */
static double holding_voltage(const bridge_t *b, int k, double u)
{
    double leg[3] = {0.0, 0.0, 0.0};
    for (int n = 0; n < 3; n++) {
        leg[n] = (n == k) ? 0.0 : leg_voltage(b, n, b->sign[n], u);
    }
    const plant_vector_t v = plant_clarke(leg);
    const plant_vector_t dpsi = {v.alpha - b->r * b->i.alpha, v.beta - b->r * b->i.beta};
    return -dot(phase_axis[k], slope_of(b, dpsi)) / admittance(b, k);
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
    b->hold = holding_voltage(b, k, u);
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
        const plant_vector_t di = slope_of(b, dpsi);
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
    e->torque = b->k_torque * cross(e->psi, e->i);
    const double impulse = third * (2.0 * b->torque + half * b->dtorque + e->torque);
    const double drag = h * (b->load + b->direction * b->friction) + b->viscous * (e->theta - b->theta);
    e->omega = (b->direction != 0.0) ? b->omega + (impulse - drag) * b->inv_inertia : 0.0;
}

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

static inline bool ends_early(const bridge_t *b, const end_t *e)
{
    const double p[3] = {e->phase[0] * b->way[0], e->phase[1] * b->way[1], e->phase[2] * b->way[2]};
    if (p[0] < 0.0 || p[1] < 0.0 || p[2] < 0.0 || e->omega * b->direction < 0.0) {
        return true;
    }
    return b->direction == 0.0 && !b->locked && fabs(e->torque - b->load) > b->friction;
}

static void find_cut(const bridge_t *b, double h, const end_t *e, cut_t *cut)
{
    double slope[3];
    phases_of(b->di, slope);
    for (int k = 0; k < 3; k++) {
        const double sign = b->way[k];
        if (e->phase[k] * sign < 0.0) {
            sooner(cut, root_of(b->phase[k] * sign, slope[k] * sign, e->phase[k] * sign, h), CURRENT_ZERO, k, 0);
        }
    }
    if (e->omega * b->direction < 0.0) {
        const double way = b->direction;
        sooner(cut, root_of(b->omega * way, b->accel * way, e->omega * way, h), STOPPED, 0, 0);
    }
    if (b->direction == 0.0 && !b->locked && !b->held) {
        const double way = (e->torque > b->load) ? 1.0 : -1.0;
        const double rest = b->friction - (e->torque - b->load) * way;
        if (rest < 0.0) {
            const double before = b->friction - (b->torque - b->load) * way;
            sooner(cut, root_of(before, -b->dtorque * way, rest, h), BROKE_LOOSE, 0, 0);
        }
    }
}

static void travel_out(const bridge_t *b, double h, plant_vector_t drive, end_t *e) { travel(b, h, drive, e); }

/* Floating leg: the mean voltage that brings its current back to zero at the end. Its voltage is a straight line to good
 * approximation, so at the end it is off by twice the mean's difference. */
static void travel_floating(const bridge_t *b, double h, double u, plant_vector_t drive, end_t *e, cut_t *cut)
{
    const int k = b->floating;
    double volts = 0.0;
    for (int pass = 0; pass < 2; pass++) {
        volts -= e->phase[k] / (admittance(b, k) * h);
        const double more = (2.0 / 3.0) * volts * h;
        const plant_vector_t corrected = {drive.alpha + more * phase_axis[k].alpha,
                                          drive.beta + more * phase_axis[k].beta};
        travel_out(b, h, corrected, e);
    }
    const double hold = b->hold;
    const double end = hold + 2.0 * volts;
    const double low = lowest(b, k, u);
    const double high = highest(b, k, u);
    if (end < low) {
        sooner(cut, h * ((hold > low) ? (hold - low) / (hold - end) : 0.0), CLAMPED, k, 1);
    } else if (end > high) {
        sooner(cut, h * ((hold < high) ? (high - hold) / (end - hold) : 0.0), CLAMPED, k, -1);
    }
}

/* Without current: until the back-EMF gets through the diodes. */
static void find_conduction(const bridge_t *b, double h, double u, const end_t *e, cut_t *cut)
{
    if (b->unplugged) {
        return;
    }
    int out = 0;
    int back = 0;
    const double late = excess(b, u, e->psi, e->omega, &out, &back);
    if (late > 0.0) {
        const double early = excess(b, u, b->psi, b->omega, &out, &back);
        sooner(cut, h * ((early < 0.0) ? early / (early - late) : 0.0), CLAMPED, -1, 0);
    }
}

/* All of it that is not the plain case. */
static void attempt(const bridge_t *b, double h, double u, end_t *e, cut_t *cut)
{
    const plant_vector_t drive = {h * (u * b->a.alpha + b->b.alpha), h * (u * b->a.beta + b->b.beta)};
    if (b->dead) {
        coast(b, h, e);
        find_conduction(b, h, u, e, cut);
    } else {
        travel_out(b, h, drive, e);
        if (b->floating >= 0) {
            travel_floating(b, h, u, drive, e, cut);
        }
    }
    if (ends_early(b, e)) {
        find_cut(b, h, e, cut);
    }
}

/* ---- moving on ---------------------------------------------------------------------------------------------------- */

static inline double decay(const bridge_t *b, double h)
{
    const unsigned n = (unsigned)(h * BRIDGE_CLOCK_HZ + 0.5);
    return (n < BRIDGE_DECAY * BRIDGE_DECAY) ? b->decay_coarse[n / BRIDGE_DECAY] * b->decay_fine[n % BRIDGE_DECAY] : 0.0;
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
        if (!b->begun) {
            bridge_begin(b, u);
        }
        end_t e;
        cut_t cut = {rest, WHOLE, 0, 0};
        attempt(b, rest, u, &e, &cut);
        if (n >= SPLITS) {
            cut = (cut_t){rest, WHOLE, 0, 0};
        } else if (cut.after < INSTANT) {
            cut.after = 0.0;
        }
        if (cut.reason != WHOLE && cut.after > 0.0) {
            cut_t again = cut;
            attempt(b, cut.after, u, &e, &again);
        }
        if (cut.after > 0.0) {
            charge += accept_out(b, cut.after, u * cut.after, &e);
            if (b->floating >= 0) {
                remove_phase(b, b->floating);
            }
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
    if (b->floating < 0 && !b->dead) {
        end_t e;
        const plant_vector_t drive = {u_h * b->a.alpha + h * b->b.alpha, u_h * b->a.beta + h * b->b.beta};
        travel(b, h, drive, &e);
        charge = ends_early(b, &e) ? split_advance(b, h, u_h / h) : accept(b, h, u_h, &e);
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
