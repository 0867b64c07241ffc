/* bridge_frame.c - segments while nothing unusual happens: the shaft goes on, or stands all along.
 *
 * For some microseconds the rotor's angle hardly changes and its speed not at all. In such a frame the currents obey
 *   i' = L^-1 v + K i + e + e' t,   K = -R L^-1 + w (J - L^-1 J L),   e = -w L^-1 J psi_m,   J = (0 -1; 1 0)
 * with L^-1 and K of its middle, and a segment is a parabola with i' and i'' = K i' + e': where a phase's current is at zero
 * is the root of one. What the parabolas leave out, (h / tau)^3 / 6 of u / L, does not add up: at the end of the frame flux
 * is the exact integral of the voltages minus R times the charge, the shaft follows from the impulse of the torque and, where
 * the magnet makes it, from its first moment, and the currents are those that belong to this flux and this angle.
 */
#include "plant/bridge_kernel.h"

#ifdef __GNUC__ /* vectors of the stator frame in one register: half of the instructions */

#include <string.h>

/* A segment, and a frame without its last one, are not longer than this: as much of the currents' time constant, of the
 * rotor's turn, and a time that pays [s]. A segment that hardly bends may be twice as long: with all legs on one side there
 * is no voltage but the back-EMF. */
#define OF_TIME_CONSTANT 0.03
#define OF_TURN 0.015 /* [rad] */
#define LONGEST 32e-6
#define SHORTEST 2e-6
#define BENT 4e-5 /* what a long segment's parabola may leave out [A] */
#define MARGIN 0.05 /* of friction, for the reluctance torque */
#define SPLITS 24 /* parts of one segment */

typedef double pair_t __attribute__((vector_size(16)));
typedef double lanes_t __attribute__((vector_size(32))); /* by phase; the fourth lane is zero. Never passed by value. */
typedef int64_t sides_t __attribute__((vector_size(32)));

static inline pair_t pair_of(const plant_vector_t *x)
{
    pair_t pair;
    memcpy(&pair, x, sizeof pair);
    return pair;
}

static inline void put(plant_vector_t *x, pair_t pair) { memcpy(x, &pair, sizeof *x); }

static inline pair_t both(double x) { return (pair_t){x, x}; }

static inline double sum(pair_t x) { return x[0] + x[1]; }

static inline pair_t product(const plant_vector_t column[2], pair_t x)
{
    return pair_of(&column[0]) * both(x[0]) + pair_of(&column[1]) * both(x[1]);
}

/* The shaft is far from standing still and from its end stops: whatever the currents do meanwhile. */
static inline bool runs_freely(const bridge_t *b)
{
    const double time = 2.0 * LONGEST;
    const double most = fabs(b->i.alpha) + fabs(b->i.beta) + time * b->u * (b->inv_l_mean + fabs(b->inv_l_half));
    const double torque = b->k_torque * (b->psi_m + fabs(b->l_d - b->l_q) * most) * most + fabs(b->load) + b->friction;
    const double reach = 2.0 * time * fabs(b->omega);
    return fabs(b->omega) > 2.0 * time * torque * b->inv_inertia && b->theta - reach > b->low &&
           b->theta + reach < b->high;
}

/* The shaft stands, and friction holds it against this torque. */
static inline bool holds(const bridge_t *b, double torque)
{
    return fabs(torque - b->load) < b->friction * (1.0 - MARGIN);
}

static inline bool stands(const bridge_t *b) { return b->omega == 0.0 && holds(b, b->torque); }

/* The torque of a current, its part from the magnet. */
static inline double aligned(const bridge_t *b, plant_vector_t i)
{
    return b->k_torque * b->psi_m * (b->cosine * i.beta - b->sine * i.alpha);
}

bool bridge_frame(bridge_t *b, double u)
{
    b->u = u;
    const bool standing = stands(b);
    if (b->locked || b->held || b->unplugged || !(standing || runs_freely(b))) {
        return false;
    }
    const double w = b->pole_pairs * b->omega;
    double longest = (10.0 * OF_TIME_CONSTANT) * b->longest;
    longest = (longest < LONGEST) ? longest : LONGEST;
    longest = (longest * fabs(w) > OF_TURN) ? OF_TURN / fabs(w) : longest;
    if (longest < SHORTEST) {
        return false;
    }
    const double x = w * (0.5 * longest);
    const double c = b->cosine * (1.0 - 0.5 * x * x) - b->sine * x;
    const double s = b->sine * (1.0 - 0.5 * x * x) + b->cosine * x;
    const bridge_matrix_t m = inverse_of(b, c, s);
    const double l_mean = 0.5 * (b->l_d + b->l_q);
    const double along = 0.5 * (b->l_d - b->l_q) * (c * c - s * s);
    const bridge_matrix_t l = {l_mean + along, (b->l_d - b->l_q) * c * s, l_mean - along};
    bridge_frame_t *f = &b->frame;
    f->longest = longest;
    f->rate = 0.1 / b->longest + fabs(w);
    f->inverse[0] = (plant_vector_t){m.aa, m.ab};
    f->inverse[1] = (plant_vector_t){m.ab, m.bb};
    f->drift[0] = (plant_vector_t){-b->r * m.aa + w * (m.aa * l.ab - m.ab * l.aa),
                                   -b->r * m.ab + w * (1.0 + m.ab * l.ab - m.bb * l.aa)};
    f->drift[1] = (plant_vector_t){-b->r * m.ab - w * (1.0 - m.aa * l.bb + m.ab * l.ab),
                                   -b->r * m.bb + w * (m.ab * l.bb - m.bb * l.ab)};
    const double emf = w * b->psi_m;
    f->push = times(m, (plant_vector_t){emf * b->sine, -emf * b->cosine});
    f->push_slope = times(m, (plant_vector_t){w * emf * c, w * emf * s});
    f->charge = f->moment = (plant_vector_t){0.0, 0.0};
    f->reluctance = b->torque - aligned(b, b->i);
    b->frame_time = 0.0;
    b->direction = standing ? 0.0 : (b->omega > 0.0) ? 1.0 : -1.0;
    b->accel =
        standing ? 0.0 : (b->torque - b->load - b->direction * b->friction - b->viscous * b->omega) * b->inv_inertia;
    b->jerk = 0.0;
    b->framed = true;
    return true;
}

/* A shaft that stands without any current: its frame is as good as new. */
static inline bool rests(const bridge_t *b) { return b->dead && b->direction == 0.0; }

/* ---- begin -------------------------------------------------------------------------------------------------------- */

/* i'' = K i' + e'. */
static inline pair_t bend_of(const bridge_frame_t *f, pair_t di)
{
    return product(f->drift, di) + pair_of(&f->push_slope);
}

/* A leg without current takes the voltage that keeps it so, or begins to conduct. */
static void begin_at_zero(bridge_t *b, int k, double u)
{
    const bridge_frame_t *f = &b->frame;
    const pair_t n = pair_of(&phase_axis[k]);
    const pair_t per_n = product(f->inverse, n);
    const double per_l = 1.0 / sum(n * per_n);
    plant_vector_t along;
    put(&along, per_n);
    const double more = settle_leg(b, k, u, along, per_l);
    const pair_t di = pair_of(&b->di);
    pair_t ddi = bend_of(f, di);
    if (b->floating < 0) {
        find_paths(b);
    } else {
        const double bent = -sum(n * ddi) * per_l;
        ddi += both(bent) * per_n;
        b->hold_slope = 1.5 * bent;
        put(&b->b, pair_of(&b->b) + both(more) * n);
    }
    put(&b->ddi, ddi);
}

static inline void begin_dead(bridge_t *b) { b->a = b->b = b->di = b->ddi = (plant_vector_t){0.0, 0.0}; }

bool bridge_frame_begin(bridge_t *b, double u)
{
    int k = leg_at_zero(b);
    const bool rested = rests(b);
    b->dead = false;
    b->floating = -1;
    b->u = u;
    if (k == NO_CURRENT) { /* the flux that such a frame begins with is that of the magnet */
        if (b->frame_time > 0.0 && !rested) {
            bridge_settle(b);
            if (!bridge_frame(b, u)) {
                return false;
            }
        }
        k = bridge_leave_one(b, u);
    }
    b->begun = true;
    find_paths(b);
    if (b->dead) {
        begin_dead(b);
        return true;
    }
    const bridge_frame_t *f = &b->frame;
    const pair_t v = both(u) * pair_of(&b->a) + pair_of(&b->b);
    const pair_t di = product(f->inverse, v) + product(f->drift, pair_of(&b->i)) + pair_of(&f->push) +
                      both(b->frame_time) * pair_of(&f->push_slope);
    put(&b->di, di);
    if (k >= 0) {
        begin_at_zero(b, k, u);
    } else {
        put(&b->ddi, bend_of(f, di));
    }
    return true;
}

/* ---- go on -------------------------------------------------------------------------------------------------------- */

static inline pair_t current_after(const bridge_t *b, double t)
{
    return pair_of(&b->i) + both(t) * (pair_of(&b->di) + both(0.5 * t) * pair_of(&b->ddi));
}

PLANT_INLINE void load(lanes_t *lanes, const double x[BRIDGE_LANES]) { memcpy(lanes, x, sizeof *lanes); }

/* How much of `rest` is one segment: its parabola leaves i''' h^3 / 6 out. */
static inline double span(const bridge_t *b, double rest)
{
    const bridge_frame_t *f = &b->frame;
    if (rest <= f->longest) {
        return rest;
    }
    const double most = (SIXTH * f->rate) * (fabs(b->ddi.alpha) + fabs(b->ddi.beta));
    return (rest < 2.0 * f->longest && rest * rest * rest * most < BENT) ? rest : f->longest;
}

static inline void phases_of_pair(pair_t i, double phase[BRIDGE_LANES])
{
    const lanes_t along_alpha = {1.0, -0.5, -0.5, 0.0};
    const lanes_t along_beta = {0.0, HALF_SQRT3, -HALF_SQRT3, 0.0};
    const lanes_t all = along_alpha * i[0] + along_beta * i[1];
    memcpy(phase, &all, sizeof all);
}

static inline bool beyond_zero(const bridge_t *b, const double phase[BRIDGE_LANES])
{
    lanes_t all, way;
    load(&all, phase);
    load(&way, b->way);
    const sides_t beyond = all * way < 0.0;
    return (beyond[0] | beyond[1] | beyond[2]) != 0;
}

bool bridge_foresee(const bridge_t *b, double h, double phase[BRIDGE_LANES])
{
    if (!b->framed || !b->begun || b->floating >= 0 || h > b->frame.longest) {
        return false;
    }
    phases_of_pair(current_after(b, h), phase);
    return !beyond_zero(b, phase);
}

/* Of the phases that have changed sides at `end`, *t seconds on: which was the first at zero, and when. */
static int first_zero(const bridge_t *b, const double end[BRIDGE_LANES], double *t)
{
    const double h = *t;
    int first = -1;
    for (int k = 0; k < 3; k++) {
        const double way = b->way[k];
        if (end[k] * way < 0.0) {
            const double zero = root_within(b->phase[k] * way, dot(phase_axis[k], b->di) * way,
                                            0.5 * dot(phase_axis[k], b->ddi) * way, h);
            if (first < 0 || zero < *t) {
                first = k;
                *t = zero;
            }
        }
    }
    return first;
}

/* The moment up to *t at which the floating leg's voltage leaves its interval; returns the sign of the current that begins
 * then. */
static inline int first_clamp(const bridge_t *b, double u, double *t)
{
    const double low = lowest(b, b->floating, u);
    const double high = highest(b, b->floating, u);
    const double end = b->hold + b->hold_slope * *t;
    if (end < low || end > high) {
        *t = (((end < low) ? low : high) - b->hold) / b->hold_slope;
        return (end < low) ? 1 : -1;
    }
    return 0;
}

/* A current that goes through zero in a leg with a gate on, where only the drop changes its sign: the segment goes on
 * with another slope. */
typedef struct {
    int phase; /* -1: none does */
    double way; /* of the current before */
    double after; /* time left then [s] */
    pair_t charge; /* that the other slope adds [A s] */
} pass_t;

#define NO_PASS ((pass_t){.phase = -1})

/* Phase k is at zero after t of a segment of `whole`. If it goes on to the other side, that is the pass, and the end of the
 * segment moves to where it leads. False, with all as it was, if the drop keeps the current at zero, if it comes back, or if
 * another one has changed sides, too. */
static inline bool pass_zero(const bridge_t *b, int k, double t, double whole, pass_t *pass, pair_t *i,
                             double phase[BRIDGE_LANES])
{
    if (b->gates[k] == BRIDGE_OPEN || b->floating >= 0 || b->shorted) {
        return false;
    }
    const pair_t n = pair_of(&phase_axis[k]);
    const double way = b->way[k];
    const pair_t more = both(way * (4.0 / 3.0) * b->v_drop) * product(b->frame.inverse, n); /* slope */
    const double slope = sum(n * (pair_of(&b->di) + both(t) * pair_of(&b->ddi) + more));
    if (!(slope * way < 0.0)) {
        return false;
    }
    const double after = whole - t;
    const pair_t end = *i + both(after) * (more + both(0.5 * after) * product(b->frame.drift, more));
    double there[BRIDGE_LANES];
    phases_of_pair(end, there);
    for (int j = 0; j < 3; j++) {
        if (there[j] * ((j == k) ? -way : b->way[j]) < 0.0) {
            return false;
        }
    }
    *pass = (pass_t){k, way, after, both(0.5 * after * after) * more};
    *i = end;
    memcpy(phase, there, sizeof there);
    return true;
}

/* What the other sign of the drop adds to the sums of a segment that ends with these phase currents. */
static inline void account_pass(bridge_t *b, const pass_t *pass, const double phase[BRIDGE_LANES])
{
    const double volt_seconds = 2.0 * b->v_drop * pass->way * pass->after;
    put(&b->psi, pair_of(&b->psi) + both((2.0 / 3.0) * volt_seconds) * pair_of(&phase_axis[pass->phase]));
    b->volt_seconds_0 += THIRD * volt_seconds;
    b->e_switch -= 0.5 * volt_seconds * phase[pass->phase];
    set_sign(b, pass->phase, (pass->way < 0.0) ? 1 : -1);
}

/* The same as filter() of bridge.c, for all phases at once. */
static inline void filter_lanes(bridge_t *b, double t, const double phase[BRIDGE_LANES])
{
    static const double through[8][BRIDGE_LANES] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0},
                                                    {0, 0, 1}, {1, 0, 1}, {0, 1, 1}, {1, 1, 1}};
    const double left = decay(b, t);
    const double tau_t = b->tau / t;
    lanes_t seen, from, to, shown;
    load(&seen, through[PHASES(b->paths, LOWER(0))]);
    load(&from, b->phase);
    load(&to, phase);
    load(&shown, b->amplifier);
    from *= seen;
    to *= seen;
    const lanes_t lag = tau_t * (to - from);
    shown = to - lag + (shown - from + lag) * left;
    memcpy(b->amplifier, &shown, sizeof shown);
}

/* The part of a segment up to t, with `more` charge than its parabola has. Returns the charge taken out of the bus. */
static inline double stride(bridge_t *b, double t, double u, pair_t i, const double phase[BRIDGE_LANES], pair_t more)
{
    const pair_t before = pair_of(&b->i);
    const pair_t a = pair_of(&b->a);
    const pair_t rest = pair_of(&b->b);
    const pair_t charge =
        both(t) * (before + both(t) * (both(0.5) * pair_of(&b->di) + both(SIXTH * t) * pair_of(&b->ddi))) + more;
    const double drawn = 1.5 * sum(a * charge);
    const double squares = (0.5 * t) * sum(before * (before + i) + i * i); /* 3/2 int i^2 */
    filter_lanes(b, t, phase);
    b->e_copper += b->r_s * squares;
    b->e_switch += b->r_on * squares - 1.5 * sum(rest * charge);
    b->e_bus += drawn * u;
    b->volt_seconds_0 += b->level * t;
    const pair_t earlier = pair_of(&b->frame.charge);
    put(&b->frame.charge, earlier + charge);
    put(&b->frame.moment, pair_of(&b->frame.moment) + both(t) * (earlier + both(SIXTH * t) * (both(2.0) * before + i)));
    pair_t psi = pair_of(&b->psi) + both(t) * (both(u) * a + rest);
    if (b->floating >= 0) {
        psi += both(THIRD * b->hold_slope * t * t) * pair_of(&phase_axis[b->floating]);
    }
    put(&b->psi, psi);
    put(&b->i, i);
    memcpy(b->phase, phase, sizeof b->phase);
    if (b->floating >= 0) {
        b->phase[b->floating] = 0.0;
    }
    b->frame_time += t;
    return drawn;
}

/* The last current ends: a frame of its own follows. */
static void end_current(bridge_t *b)
{
    bridge_settle(b);
    bridge_remove_all(b);
}

double bridge_frame_advance(bridge_t *b, double *rest, double u)
{
    double drawn = 0.0;
    for (int n = 0; n < SPLITS && *rest > INSTANT; n++) {
        if (!b->begun && !((b->framed || bridge_frame(b, u)) && bridge_frame_begin(b, u))) {
            return drawn;
        }
        double t = span(b, *rest);
        double phase[BRIDGE_LANES];
        int zero = -1;
        int sign = 0;
        pass_t pass = NO_PASS;
        pair_t i = current_after(b, t);
        phases_of_pair(i, phase);
        if (beyond_zero(b, phase)) {
            const double whole = t;
            zero = first_zero(b, phase, &t);
            if (pass_zero(b, zero, t, whole, &pass, &i, phase)) {
                t = whole;
                zero = -1;
            }
        }
        if (b->floating >= 0 && (sign = first_clamp(b, u, &t)) != 0) {
            zero = -1;
        }
        if (zero >= 0 || sign != 0) {
            i = current_after(b, t);
            phases_of_pair(i, phase);
        }
        if (b->direction == 0.0 && !holds(b, aligned(b, (plant_vector_t){i[0], i[1]}))) {
            break;
        }
        if (t > INSTANT) {
            drawn += stride(b, t, u, i, phase, pass.charge);
            *rest -= t;
            if (pass.phase >= 0) {
                account_pass(b, &pass, phase);
            }
        }
        if (b->floating >= 0) {
            if (sign != 0) {
                set_sign(b, b->floating, sign);
            } else if (zero >= 0) {
                end_current(b);
            }
        } else if (zero >= 0) {
            set_sign(b, zero, 0);
            b->phase[zero] = 0.0;
        }
        b->begun = false;
        if (b->frame_time > 0.99 * b->frame.longest && !rests(b)) {
            bridge_settle(b);
        }
    }
    if (*rest > INSTANT) {
        bridge_settle(b);
    }
    return drawn;
}

#else

bool bridge_frame(bridge_t *b, double u)
{
    (void)b;
    (void)u;
    return false;
}

bool bridge_frame_begin(bridge_t *b, double u) { return bridge_frame(b, u); }

double bridge_frame_advance(bridge_t *b, double *rest, double u)
{
    (void)b;
    (void)rest;
    (void)u;
    return 0.0;
}

bool bridge_foresee(const bridge_t *b, double h, double phase[BRIDGE_LANES])
{
    (void)b;
    (void)h;
    (void)phase;
    return false;
}

#endif

void bridge_settle(bridge_t *b)
{
    if (!b->framed) {
        return;
    }
    b->framed = b->begun = false;
    b->moved = true;
    if (b->frame_time <= 0.0) {
        return;
    }
    const double h = b->frame_time;
    const double k_psi = b->k_torque * b->psi_m;
    const plant_vector_t charge = b->frame.charge;
    const plant_vector_t moment = b->frame.moment;
    b->charge.alpha += charge.alpha;
    b->charge.beta += charge.beta;
    const double early = k_psi * (b->cosine * charge.beta - b->sine * charge.alpha);
    const double first = k_psi * (b->cosine * moment.beta - b->sine * moment.alpha);
    const double drag = b->load + b->direction * b->friction;
    end_t e;
    const bool standing = b->direction == 0.0;
    const double mean = 2.0 * first / (h * h) - drag - b->viscous * b->omega; /* for the angle, if flux stood */
    b->accel = standing ? 0.0 : mean * b->inv_inertia;
    b->jerk = 0.0;
    turn(b, h, &e);
    e.psi = (plant_vector_t){b->psi.alpha - b->r * charge.alpha, b->psi.beta - b->r * charge.beta};
    e.i = current_of(b, e.inverse, e.psi, e.cosine, e.sine);
    const int zero = leg_at_zero(b);
    if (zero == NO_CURRENT) {
        e.psi = (plant_vector_t){b->psi_m * e.cosine, b->psi_m * e.sine};
        e.i = (plant_vector_t){0.0, 0.0};
    } else if (zero >= 0) {
        const plant_vector_t n = phase_axis[zero];
        const plant_vector_t per_n = times(e.inverse, n);
        (void)hold_at_zero(n, per_n, 1.0 / dot(n, per_n), &e);
    }
    const double late = k_psi * (e.cosine * charge.beta - e.sine * charge.alpha);
    e.torque = b->k_torque * cross(e.psi, e.i);
    const double reluctance =
        (0.5 * h) * (b->frame.reluctance + e.torque - k_psi * (e.cosine * e.i.beta - e.sine * e.i.alpha));
    const double impulse = 0.5 * (early + late) + reluctance - h * drag - b->viscous * (e.theta - b->theta);
    b->omega += standing ? 0.0 : impulse * b->inv_inertia;
    b->theta = e.theta;
    b->cosine = e.cosine;
    b->sine = e.sine;
    b->inverse = e.inverse;
    b->psi = e.psi;
    b->i = e.i;
    b->torque = e.torque;
    phases_of(b->i, b->phase);
    if (zero >= 0 && zero != NO_CURRENT) {
        b->phase[zero] = 0.0;
        b->phase[(zero + 1) % 3] = -b->phase[(zero + 2) % 3];
    }
    b->frame_time = 0.0;
}
