#include "plant/bridge.h"

#include <math.h>

#include "plant/decay.h"
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

void bridge_init(bridge_t *bridge, const plant_axis_t *config)
{
    const double v = config->v_drop;
    const double x = (config->i_settle > 0.0) ? 1.0 / (BRIDGE_CLOCK_HZ * config->i_settle) : 800.0;
    *bridge = (bridge_t){
        .path =
            {
                [BRIDGE_OPEN] = {{1.0, v, false}, {0.0, 0.0, false}, {0.0, -v, true}},
                [BRIDGE_HIGH] = {{1.0, v, false}, {0.0, 0.0, false}, {1.0, -v, false}},
                [BRIDGE_LOW] = {{0.0, v, true}, {0.0, 0.0, true}, {0.0, -v, true}},
            },
        .r_s = config->r_s,
        .r_on = config->r_on,
        .l_d = config->l_d,
        .l_q = config->l_q,
        .inv_l_d = 1.0 / config->l_d,
        .inv_l_q = 1.0 / config->l_q,
        .psi_m = config->psi_m,
        .pole_pairs = config->pole_pairs,
        .inertia = config->inertia,
        .inv_inertia = 1.0 / config->inertia,
        .friction = config->friction,
        .viscous = config->viscous,
        .tau = config->i_settle,
        .theta = config->theta_start,
    };
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

/* di/dt at the beginning of a segment with the leg voltages v: i' = L^-1 (v - R i - j w psi) + j w i, from
 * d/dt of e^{j theta} L^-1 (e^{-j theta} psi - psi_m). */
static inline plant_vector_t slope_of(const bridge_t *b, plant_vector_t v)
{
    const double r = b->r_s + b->r_on;
    const double w = b->pole_pairs * b->omega;
    const plant_vector_t drive = {v.alpha - r * b->i.alpha + w * b->psi.beta, v.beta - r * b->i.beta - w * b->psi.alpha};
    const plant_vector_t rate = per_inductance(b, drive);
    return (plant_vector_t){rate.alpha - w * b->i.beta, rate.beta + w * b->i.alpha};
}

/* Ends of the interval of a leg without current. */
static inline double lowest(const bridge_t *b, int k, double u)
{
    const bridge_path_t *path = &b->path[b->gates[k]][2];
    return path->upper * u + path->drop;
}

static inline double highest(const bridge_t *b, int k, double u)
{
    const bridge_path_t *path = &b->path[b->gates[k]][0];
    return path->upper * u + path->drop;
}

/* ---- which way the currents go ------------------------------------------------------------------------------------ */

/* Slope of a phase current per volt on its own leg. */
static double admittance(const bridge_t *b, int k)
{
    return (2.0 / 3.0) * dot(phase_axis[k], per_inductance(b, phase_axis[k]));
}

/* Voltage of leg k that keeps its current at zero while the other two legs have theirs. */
static double holding_voltage(const bridge_t *b, int k, const double leg[3])
{
    double v[3] = {leg[0], leg[1], leg[2]};
    v[k] = 0.0;
    return -dot(phase_axis[k], slope_of(b, plant_clarke(v))) / admittance(b, k);
}

static int pulled(double hold, double low, double high) { return (hold < low) ? 1 : (hold > high) ? -1 : 0; }

/* By how much the back-EMF exceeds what the legs block, all of them without current; and between which two [V]. */
static double excess(const bridge_t *b, double u, int *out, int *back)
{
    const double w = b->pole_pairs * b->omega;
    const plant_vector_t emf = {-w * b->psi.beta, w * b->psi.alpha}; /* psi is that of the magnet alone */
    double push = -1e300;
    double pull = 1e300;
    for (int k = 0; k < 3; k++) {
        const double e = dot(phase_axis[k], emf);
        const double from = lowest(b, k, u) - e;
        const double to = highest(b, k, u) - e;
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

/* Decide on the legs without current. Returns the leg voltage of a floating one. */
static double decide(bridge_t *b, double u)
{
    double leg[3] = {0.0, 0.0, 0.0};
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
        b->sign[0] = b->sign[1] = b->sign[2] = 0;
        b->dead = b->unplugged || excess(b, u, &out, &back) <= 0.0 || out == back;
        if (b->dead) {
            return 0.0;
        }
        b->sign[out] = 1;
        b->sign[back] = -1;
        k = 3 - out - back;
    }
    for (int n = 0; n < 3; n++) {
        const bridge_path_t *path = &b->path[b->gates[n]][b->sign[n] + 1];
        leg[n] = path->upper * u + path->drop;
    }
    const double hold = holding_voltage(b, k, leg);
    b->sign[k] = pulled(hold, lowest(b, k, u), highest(b, k, u));
    b->floating = (b->sign[k] == 0) ? k : -1;
    return hold;
}

static int direction_of(const bridge_t *b)
{
    if (b->locked || b->held) {
        return 0;
    }
    if (b->omega > STANDING || b->omega < -STANDING) {
        return (b->omega > 0.0) ? 1 : -1;
    }
    const double drive = b->torque - b->load;
    const int way = (drive > 0.0) ? 1 : -1;
    const double rest = drive * way - b->friction;
    return (rest > 0.0 || (rest > -THRESHOLD * b->friction && b->dtorque * way > 0.0)) ? way : 0;
}

void bridge_begin(bridge_t *b, double u)
{
    const bridge_path_t *path[3];
    b->floating = -1;
    b->dead = false;
    if (b->sign[0] == 0 || b->sign[1] == 0 || b->sign[2] == 0) {
        b->hold = decide(b, u);
    }
    for (int k = 0; k < 3; k++) {
        path[k] = &b->path[b->gates[k]][b->sign[k] + 1];
        b->lower[k] = path[k]->lower;
    }
    double upper[3] = {path[0]->upper, path[1]->upper, path[2]->upper};
    double drop[3] = {path[0]->drop, path[1]->drop, path[2]->drop};
    if (b->floating >= 0) {
        drop[b->floating] = b->hold;
    }
    b->a = plant_clarke(upper);
    b->b = plant_clarke(drop);
    b->a_0 = (upper[0] + upper[1] + upper[2]) * THIRD;
    b->b_0 = (drop[0] + drop[1] + drop[2]) * THIRD;
    if (b->dead) {
        const double w = b->pole_pairs * b->omega;
        b->a = (plant_vector_t){0.0, 0.0};
        b->b = (plant_vector_t){-w * b->psi.beta, w * b->psi.alpha};
        b->a_0 = 0.5;
        b->b_0 = 0.0;
        b->di = (plant_vector_t){0.0, 0.0};
        b->dtorque = 0.0;
    } else {
        const double r = b->r_s + b->r_on;
        const plant_vector_t v = {u * b->a.alpha + b->b.alpha, u * b->a.beta + b->b.beta};
        const plant_vector_t dpsi = {v.alpha - r * b->i.alpha, v.beta - r * b->i.beta};
        b->di = slope_of(b, v);
        b->dtorque = 1.5 * b->pole_pairs * (cross(dpsi, b->i) + cross(b->psi, b->di));
    }
    b->direction = direction_of(b);
    if (b->direction == 0) {
        b->omega = 0.0;
        b->accel = 0.0;
        b->jerk = 0.0;
    } else {
        b->accel = (b->torque - b->load - b->direction * b->friction - b->viscous * b->omega) * b->inv_inertia;
        b->jerk = (b->dtorque - b->viscous * b->accel) * b->inv_inertia;
    }
    b->begun = true;
}

/* ---- one step ----------------------------------------------------------------------------------------------------- */

/* The shaft, and the rotor's angle with it. */
static inline void turn(const bridge_t *b, double h, end_t *e)
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
static inline void travel(const bridge_t *b, double h, plant_vector_t drive, end_t *e)
{
    const double r = b->r_s + b->r_on;
    const double third = THIRD * h;
    turn(b, h, e);
    const plant_vector_t free = {b->psi.alpha + drive.alpha, b->psi.beta + drive.beta};
    const plant_vector_t guess = {free.alpha - r * h * (b->i.alpha + 0.5 * h * b->di.alpha),
                                  free.beta - r * h * (b->i.beta + 0.5 * h * b->di.beta)};
    const plant_vector_t i_guess = current_of(b, guess, e->cosine, e->sine);
    const plant_vector_t begun = {2.0 * b->i.alpha + 0.5 * h * b->di.alpha, 2.0 * b->i.beta + 0.5 * h * b->di.beta};
    e->charge.alpha = third * (begun.alpha + i_guess.alpha);
    e->charge.beta = third * (begun.beta + i_guess.beta);
    e->psi.alpha = free.alpha - r * e->charge.alpha;
    e->psi.beta = free.beta - r * e->charge.beta;
    e->i = current_of(b, e->psi, e->cosine, e->sine);
    phases_of(e->i, e->phase);
    e->torque = 1.5 * b->pole_pairs * cross(e->psi, e->i);
    if (b->direction == 0) {
        e->omega = 0.0;
    } else {
        const double impulse = third * (2.0 * b->torque + 0.5 * h * b->dtorque + e->torque);
        const double drag = h * (b->load + b->direction * b->friction) + b->viscous * (e->theta - b->theta);
        e->omega = b->omega + (impulse - drag) * b->inv_inertia;
    }
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
    const bool crossed = e->phase[0] * b->sign[0] < 0.0 || e->phase[1] * b->sign[1] < 0.0 || e->phase[2] * b->sign[2] < 0.0;
    const bool turned = e->omega * b->direction < 0.0;
    return crossed || turned || (b->direction == 0 && !b->locked && fabs(e->torque - b->load) > b->friction);
}

static void find_cut(const bridge_t *b, double h, const end_t *e, cut_t *cut)
{
    double slope[3];
    phases_of(b->di, slope);
    for (int k = 0; k < 3; k++) {
        const int sign = b->sign[k];
        if (e->phase[k] * sign < 0.0) {
            sooner(cut, root_of(b->phase[k] * sign, slope[k] * sign, e->phase[k] * sign, h), CURRENT_ZERO, k, 0);
        }
    }
    if (e->omega * b->direction < 0.0) {
        const int way = b->direction;
        sooner(cut, root_of(b->omega * way, b->accel * way, e->omega * way, h), STOPPED, 0, 0);
    }
    if (b->direction == 0 && !b->locked && !b->held) {
        const int way = (e->torque > b->load) ? 1 : -1;
        const double rest = b->friction - (e->torque - b->load) * way;
        if (rest < 0.0) {
            const double before = b->friction - (b->torque - b->load) * way;
            sooner(cut, root_of(before, -b->dtorque * way, rest, h), BROKE_LOOSE, 0, way);
        }
    }
}

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
        travel(b, h, corrected, e);
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
    bridge_t after = *b;
    after.psi = e->psi;
    after.omega = e->omega;
    int out = 0;
    int back = 0;
    const double late = excess(&after, u, &out, &back);
    if (late > 0.0) {
        const double early = excess(b, u, &out, &back);
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
        travel(b, h, drive, e);
        if (b->floating >= 0) {
            travel_floating(b, h, u, drive, e, cut);
        }
    }
    find_cut(b, h, e, cut);
}

/* ---- moving on ---------------------------------------------------------------------------------------------------- */

static inline double decay(const bridge_t *b, double h)
{
    const unsigned n = (unsigned)(h * BRIDGE_CLOCK_HZ + 0.5);
    return (n < BRIDGE_DECAY * BRIDGE_DECAY) ? b->decay_coarse[n / BRIDGE_DECAY] * b->decay_fine[n % BRIDGE_DECAY] : 0.0;
}

/* Take over the end of a step of length h > 0. Returns the charge taken out of the bus. */
static inline double accept(bridge_t *b, double h, double u_h, const end_t *e)
{
    const double per_h = 1.0 / h;
    const double left = decay(b, h);
    for (int k = 0; k < 3; k++) { /* first-order lag behind a straight line, exact */
        const double from = b->lower[k] ? b->phase[k] : 0.0;
        const double to = b->lower[k] ? e->phase[k] : 0.0;
        const double lag = b->tau * per_h * (to - from);
        b->amplifier[k] = to - lag + (b->amplifier[k] - from + lag) * left;
    }
    const double charge = 1.5 * dot(b->a, e->charge);
    const double squares = (0.5 * h) * (dot(b->i, b->i) + dot(b->i, e->i) + dot(e->i, e->i)); /* 3/2 int i^2 */
    b->e_copper += b->r_s * squares;
    b->e_switch += b->r_on * squares - 1.5 * dot(b->b, e->charge);
    b->e_bus += charge * u_h * per_h;
    b->volt_seconds.alpha += b->a.alpha * u_h + b->b.alpha * h - b->r_on * e->charge.alpha;
    b->volt_seconds.beta += b->a.beta * u_h + b->b.beta * h - b->r_on * e->charge.beta;
    b->volt_seconds_0 += b->a_0 * u_h + b->b_0 * h;
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
        b->sign[k] = 0;
    }
}

/* What is different after an early end. */
static void apply(bridge_t *b, const cut_t *cut)
{
    switch (cut->reason) {
    case CURRENT_ZERO:
        b->sign[cut->phase] = 0;
        if (b->floating >= 0) {
            remove_all(b);
        } else {
            remove_phase(b, cut->phase);
        }
        break;
    case CLAMPED:
        if (cut->phase >= 0) {
            b->sign[cut->phase] = cut->sign;
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
            charge += accept(b, cut.after, u * cut.after, &e);
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
    const double slope = dot(b->di, phase_axis[k]);
    const double from = b->lower[k] ? b->phase[k] : 0.0;
    const double to = b->lower[k] ? b->phase[k] + h * slope : 0.0;
    const double lag = b->lower[k] ? b->tau * slope : 0.0;
    return to - lag + (b->amplifier[k] - from + lag) * decay(b, h);
}

bool bridge_indifferent(const bridge_t *b, int k, bridge_gates_t gates, double h)
{
    if (!b->begun || b->sign[k] == 0) {
        return false;
    }
    const bridge_path_t *path = &b->path[b->gates[k]][b->sign[k] + 1];
    const bridge_path_t *next = &b->path[gates][b->sign[k] + 1];
    const double now = b->sign[k] * (b->phase[k] + h * dot(b->di, phase_axis[k]));
    return path->upper == next->upper && path->drop == next->drop && path->lower == next->lower && now > 1e8 * h * h;
}

void bridge_set_winding(bridge_t *b, double r_s) { b->r_s = r_s; }

void bridge_plug(bridge_t *b, bool plugged)
{
    b->unplugged = !plugged;
    b->begun = false;
    if (!plugged) {
        remove_all(b);
    }
}
