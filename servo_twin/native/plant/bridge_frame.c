/* bridge_frame.c - segments while nothing unusual happens: the shaft goes on, or stands all along.
 *
 * For some microseconds the rotor's angle hardly changes and its speed nearly as little. In such a frame the currents obey
 *   i' = L^-1 v + K i + e + e' t,   K = -R L^-1 + w (J - L^-1 J L),   e = -w L^-1 J psi_m,   J = (0 -1; 1 0)
 * with L^-1 and K of its middle and the acceleration of the frame before in e', and a segment is a parabola with i' and
 * i'' = K i' + e', or a few where currents go through zero (bridge_course.h). What the parabolas leave out,
 * (h / tau)^3 / 6 of u / L, does not add up: at the end of the frame flux is the exact integral of the voltages minus R times
 * the charge, the shaft follows from the impulse of the torque and, where the magnet makes it, from its first moment, and the
 * currents are those that belong to this flux and this angle.
 */
#include "plant/bridge_kernel.h"

/* Acceleration in the frame so far, as the angle sees it, by the first moment of the torque, if flux stood. */
static inline double mean_accel(const bridge_t *b)
{
    const double h = b->frame.time;
    if (b->direction == 0.0 || h <= 0.0) {
        return 0.0;
    }
    const plant_vector_t moment = b->frame.moment;
    const double first = b->k_torque * b->psi_m * (b->cosine * moment.beta - b->sine * moment.alpha);
    const double drag = b->load + b->direction * b->friction + b->viscous * b->omega;
    return (2.0 * first / (h * h) - drag) * b->inv_inertia;
}

/* Without any current the flux is that of the magnet, where it looks by now. */
static inline plant_vector_t magnet(const bridge_t *b)
{
    const double t = b->frame.time;
    const double x = b->pole_pairs * t * (b->omega + 0.5 * t * mean_accel(b));
    const double c = 1.0 - 0.5 * x * x;
    const double s = x * (1.0 - SIXTH * x * x);
    return (plant_vector_t){b->psi_m * (b->cosine * c - b->sine * s), b->psi_m * (b->sine * c + b->cosine * s)};
}

#if defined(__GNUC__) && !defined(PLANT_NO_FRAMES) /* a stator vector and its phases in one register */

#include "plant/bridge_course.h"

/* Longest frame (without its last segment), longest segment, and longest one with all legs on one side, where there is no
 * voltage but the back-EMF: as much of the currents' time constant, of the rotor's turn, and a PWM period [s]. */
#define FRAME_OF_TIME_CONSTANT 0.08
#define DRIVEN_OF_TIME_CONSTANT 0.03
#define IDLE_OF_TIME_CONSTANT 0.05
#define OF_TURN 0.016 /* [rad] */
#define SHORTEST 2e-6
#define MARGIN 0.05 /* of friction, for the reluctance torque */
#define SPLITS 24 /* parts of one segment */

/* The shaft is far from standing still and from its end stops: whatever the currents do meanwhile. */
static inline bool runs_freely(const bridge_t *b)
{
    const double time = 2.0 * BRIDGE_FRAME;
    const double most = fabs(b->i.alpha) + fabs(b->i.beta) + time * b->u * b->inv_l_most;
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

static inline double shorter(double a, double b) { return (a < b) ? a : b; }

PLANT_WIDE bool bridge_frame(bridge_t *b, double u)
{
    b->u = u;
    const bool standing = stands(b);
    if (b->saturates || b->locked || b->held || b->unplugged || b->shorted || !(standing || runs_freely(b))) {
        return false;
    }
    const double w = b->pole_pairs * b->omega;
    const double time_constant = 10.0 * b->longest;
    double longest = shorter(BRIDGE_FRAME, FRAME_OF_TIME_CONSTANT * time_constant);
    longest = (longest * fabs(w) > OF_TURN) ? OF_TURN / fabs(w) : longest;
    const double longest_driven = shorter(longest, DRIVEN_OF_TIME_CONSTANT * time_constant);
    if (longest_driven < SHORTEST) {
        return false;
    }
    const double x = w * (0.5 * longest);
    const double c = b->cosine * (1.0 - 0.5 * x * x) - b->sine * x;
    const double s = b->sine * (1.0 - 0.5 * x * x) + b->cosine * x;
    const bridge_matrix_t m = inverse_of(b, c, s);
    const double l_mean = 0.5 * (b->l_d + b->l_q);
    const double l_half = 0.5 * (b->l_d - b->l_q) * (c * c - s * s);
    const bridge_matrix_t l = {l_mean + l_half, (b->l_d - b->l_q) * c * s, l_mean - l_half};
    bridge_frame_t *f = &b->frame;
    f->longest = longest;
    f->longest_segment[false] = longest_driven;
    f->longest_segment[true] = shorter(longest, IDLE_OF_TIME_CONSTANT * time_constant);
    put_lanes(f->inverse[0], spread(m.aa, m.ab));
    put_lanes(f->inverse[1], spread(m.ab, m.bb));
    put_lanes(f->drift[0], spread(-b->r * m.aa + w * (m.aa * l.ab - m.ab * l.aa),
                                  -b->r * m.ab + w * (1.0 + m.ab * l.ab - m.bb * l.aa)));
    put_lanes(f->drift[1], spread(-b->r * m.ab - w * (1.0 - m.aa * l.bb + m.ab * l.ab),
                                  -b->r * m.bb + w * (m.ab * l.bb - m.bb * l.ab)));
    const double emf = w * b->psi_m;
    const plant_vector_t push = times(m, (plant_vector_t){emf * b->sine, -emf * b->cosine});
    const double gain = standing ? 0.0 : b->pole_pairs * b->psi_m * b->accel; /* as in the frame before */
    const plant_vector_t push_slope = times(m, (plant_vector_t){w * emf * c + gain * s, w * emf * s - gain * c});
    put_lanes(f->push, spread(push.alpha, push.beta));
    put_lanes(f->push_slope, spread(push_slope.alpha, push_slope.beta));
    for (int k = 0; k < 3; k++) {
        const plant_vector_t along = times(m, phase_axis[k]);
        put_lanes(f->along[k], spread(2.0 * THIRD * along.alpha, 2.0 * THIRD * along.beta));
        put_lanes(f->bend[k], product(f->drift, lanes_of(f->along[k])));
    }
    put_lanes(f->hold, all(-1.0) / (lanes_t){f->along[0][BRIDGE_LANE(0)], 1.0, f->along[1][BRIDGE_LANE(1)],
                                             f->along[2][BRIDGE_LANE(2)]});
    put_lanes(f->i, (lanes_t){b->i.alpha, b->i.beta, b->phase[1], b->phase[2]});
    f->charge = f->moment = (plant_vector_t){0.0, 0.0};
    put_pair(f->squares, both(0.0));
    put_pair(f->work, both(0.0));
    f->taken = 0.0;
    f->reluctance = b->torque - aligned(b, b->i);
    f->time = 0.0;
    b->direction = standing ? 0.0 : (b->omega > 0.0) ? 1.0 : -1.0;
    b->accel =
        standing ? 0.0 : (b->torque - b->load - b->direction * b->friction - b->viscous * b->omega) * b->inv_inertia;
    b->jerk = 0.0;
    b->moved = true; /* on another course than a step before */
    find_bend(b);
    b->framed = true;
    return true;
}

/* A shaft that stands without any current: its frame is as good as new. */
static inline bool rests(const bridge_t *b) { return b->dead && b->direction == 0.0; }

/* ---- begin -------------------------------------------------------------------------------------------------------- */

/* A leg without current takes the voltage that keeps it so, or begins to conduct. */
PLANT_INLINE void settle_at_zero(bridge_t *b, segment_t *s, int k, double u)
{
    bridge_frame_t *f = &b->frame;
    const lanes_t along = lanes_of(f->along[k]);
    const double needed = phase_of(lanes_of(f->hold) * s->di, k);
    const double lift = settle_leg(b, k, low_end(b, k, u), high_end(b, k, u), needed);
    s->v += all(lift) * lanes_of(legs_at[BRIDGE_LEG(k)]);
    s->di += all(lift) * along;
    s->ddi += all(lift) * lanes_of(f->bend[k]);
    if (b->floating >= 0) { /* its voltage has to change for its current to stay at zero */
        f->hold_slope = phase_of(lanes_of(f->hold) * s->ddi, k);
        s->ddi += all(f->hold_slope) * along;
    } else {
        find_way(b);
    }
}

/* A current begins within a frame: what its earlier charge has cost will come off at its end. */
static inline void leave_magnet(bridge_t *b)
{
    b->psi.alpha += b->r * b->frame.charge.alpha;
    b->psi.beta += b->r * b->frame.charge.beta;
}

/* With the present gates, from the currents in `s`. */
PLANT_INLINE void begin_segment(bridge_t *b, segment_t *s, double u)
{
    const bridge_frame_t *f = &b->frame;
    int k = leg_at_zero(b);
    b->dead = false;
    b->floating = -1;
    b->u = u;
    b->begun = true;
    if (k == NO_CURRENT) {
        b->psi = magnet(b);
        k = bridge_leave_one(b, u);
        if (!b->dead) {
            leave_magnet(b);
        }
    }
    find_way(b);
    s->v = all(u) * lanes_of(legs_at[b->paths.upper]) + lanes_of(b->drops[b->paths.raised]);
    if (b->dead) {
        s->v *= (lanes_t){0.0, 0.0, 1.0, 0.0};
        s->di = s->ddi = all(0.0);
        return;
    }
    const lanes_t push_slope = lanes_of(f->push_slope);
    s->di = product_and(f->drift, s->i, product_and(f->inverse, s->v, lanes_of(f->push) + all(f->time) * push_slope));
    s->ddi = product_and(f->drift, s->di, push_slope); /* i'' = K i' + e' */
    if (k >= 0) {
        settle_at_zero(b, s, k, u);
    }
}

PLANT_WIDE PLANT_ONCE void bridge_frame_begin(bridge_t *b, double u)
{
    segment_t s = {.i = lanes_of(b->frame.i)};
    begin_segment(b, &s, u);
    keep_segment(b, &s);
}

/* ---- go on -------------------------------------------------------------------------------------------------------- */

/* How much of `rest` is one segment. */
static inline double span(const bridge_t *b, double rest)
{
    const bool idle = (unsigned)(b->paths.upper == 0u) | (unsigned)(b->paths.upper == BRIDGE_LEGS);
    return shorter(rest, b->frame.longest_segment[idle]);
}

/* The moment up to *t at which the floating leg's voltage leaves its interval, whose ends follow the bus; returns the sign
 * of the current that begins then. */
static inline int first_clamp(const bridge_t *b, double u, double *t)
{
    const double low = low_end(b, b->floating, u);
    const double high = high_end(b, b->floating, u);
    const double end = b->hold + b->frame.hold_slope * *t;
    if (end >= low && end <= high) {
        return 0;
    }
    const double left = (((end < low) ? low : high) - b->hold) / b->frame.hold_slope;
    *t = (b->hold > low && b->hold < high) ? shorter(left, *t) : 0.0;
    return (end < low) ? 1 : -1;
}

/* The amplifiers of all phases, h seconds into the segment, follow what goes through their shunts, as late as its slope says,
 * the one that they see by now; what is left of earlier times decays. */
PLANT_INLINE lanes_t filtered(const bridge_t *b, const segment_t *s, double h, lanes_t i, lanes_t slope)
{
    static const double through[BRIDGE_LEG_SETS][BRIDGE_LANES] PLANT_VECTORS = {
        [LEG_A] = {1, 0, 0, 0},       [LEG_B] = {0, 0, 1, 0},         [LEG_A | LEG_B] = {1, 0, 1, 0},
        [LEG_C] = {0, 0, 0, 1},       [LEG_A | LEG_C] = {1, 0, 0, 1}, [LEG_B | LEG_C] = {0, 0, 1, 1},
        [BRIDGE_LEGS] = {1, 0, 1, 1},
    };
    const lanes_t seen = lanes_of(through[b->paths.lower]);
    const lanes_t tau = all(b->tau);
    const lanes_t off = lanes_of(b->amplifier) - seen * (s->i - tau * s->di);
    return seen * (i - tau * slope) + off * all(decay(b, h));
}

PLANT_WIDE bool bridge_foresee(const bridge_t *b, double h, double shown[BRIDGE_LANES])
{
    if (!b->framed || !b->begun || b->floating >= 0 || h > span(b, h)) {
        return false;
    }
    const segment_t s = segment_of(b);
    course_t c;
    start_course(&c, b, &s, h);
    put_lanes(shown, filtered(b, &s, h, c.last, slope_at(&c, h)));
    return beyond_zero(c.last, b->positive, b->negative) == 0u;
}

/* The segment, as it has gone. */
PLANT_INLINE void stride(bridge_t *b, const segment_t *s, const course_t *c, const pass_t *pass, double u,
                         double *drawn)
{
    bridge_frame_t *f = &b->frame;
    const double t = c->end;
    const lanes_t v = s->v + all(u - b->u) * lanes_of(legs_at[b->paths.upper]); /* the bus has moved since */
    const pair_t before = vector(s->i);
    const pair_t after = vector(c->last);
    pair_t charge = both(t) * (before + both(t) * (both(0.5) * vector(s->di) + both(SIXTH * t) * vector(s->ddi)));
    lanes_t impulse = all(t) * v;
    lanes_t slope = slope_at(c, t);
    if (c->passes > 0) {
        account_passes(c, pass, b, &charge, &impulse, &slope, &f->taken);
    }
    put_lanes(b->amplifier, filtered(b, s, t, c->last, slope));
    if (b->floating >= 0) {
        impulse += all(0.5 * f->hold_slope * t * t) * lanes_of(legs_at[BRIDGE_LEG(b->floating)]);
    }
    const double taken = 1.5 * sum(pair_of(&b->a) * charge);
    f->taken += taken * u;
    *drawn += taken;
    put_pair(f->squares, pair_at(f->squares) + both(0.5 * t) * (before * (before + after) + after * after));
    put_pair(f->work, pair_at(f->work) + vector(v) * charge);
    const pair_t earlier = pair_of(&f->charge);
    put(&f->charge, earlier + charge);
    put(&f->moment, pair_of(&f->moment) + both(t) * (earlier + both(SIXTH * t) * (both(2.0) * before + after)));
    put(&b->psi, pair_of(&b->psi) + vector(impulse));
    b->volt_seconds_0 += impulse[LEGS_MEAN];
    f->time += t;
}

/* Signs and currents where the segment has ended: at zero in leg `zero` unless that is -1, and a leg that has floated begins
 * to conduct unless `sign` is 0. */
PLANT_INLINE lanes_t end_segment(bridge_t *b, const course_t *c, int zero, int sign)
{
    b->positive = c->positive;
    b->negative = c->negative;
    if (sign != 0) {
        set_sign(b, b->floating, sign);
        return without(c->last, b->floating);
    }
    if (zero >= 0 && c->floating >= 0) { /* the last current */
        b->positive = b->negative = 0u;
        return all(0.0);
    }
    if (zero >= 0 || c->floating >= 0) {
        const int k = (zero >= 0) ? zero : c->floating;
        set_sign(b, k, 0);
        return without(c->last, k);
    }
    return c->last;
}

/* The currents, for others. */
PLANT_INLINE void show(bridge_t *b, lanes_t i)
{
    put(&b->i, vector(i));
    b->phase[0] = i[BRIDGE_LANE(0)];
    b->phase[1] = i[BRIDGE_LANE(1)];
    b->phase[2] = i[BRIDGE_LANE(2)];
}

PLANT_WIDE PLANT_ONCE double bridge_frame_advance(bridge_t *b, double *rest, double u)
{
    bridge_frame_t *f = &b->frame;
    double drawn = 0.0;
    for (int n = 0; n < SPLITS && *rest > INSTANT; n++) {
        if (!b->begun) {
            if (!b->framed && !bridge_frame(b, u)) {
                break;
            }
            bridge_frame_begin(b, u);
        }
        const segment_t s = segment_of(b);
        course_t c;
        pass_t pass[PASSES];
        start_course(&c, b, &s, span(b, *rest));
        const int zero = follow_course(&c, pass, b, u);
        const int sign = (b->floating >= 0) ? first_clamp(b, u, &c.end) : 0;
        if (zero >= 0 || sign != 0) {
            c.last = course_at(&c, c.end);
        }
        if (b->direction == 0.0 && !holds(b, aligned(b, (plant_vector_t){c.last[0], c.last[1]}))) {
            break;
        }
        if (c.end > INSTANT) {
            stride(b, &s, &c, pass, u, &drawn);
            *rest -= c.end;
        }
        put_lanes(f->i, end_segment(b, &c, zero, sign));
        b->begun = false;
        if (f->time > 0.99 * f->longest && !rests(b)) {
            bridge_settle(b);
        }
    }
    if (*rest > INSTANT) {
        bridge_settle(b);
    }
    if (b->framed) {
        show(b, lanes_of(f->i));
    }
    b->e_bus += drawn * u;
    return drawn;
}

#else

bool bridge_frame(bridge_t *b, double u)
{
    (void)b;
    (void)u;
    return false;
}

void bridge_frame_begin(bridge_t *b, double u)
{
    (void)b;
    (void)u;
}

double bridge_frame_advance(bridge_t *b, double *rest, double u)
{
    (void)b;
    (void)rest;
    (void)u;
    return 0.0;
}

bool bridge_foresee(const bridge_t *b, double h, double shown[BRIDGE_LANES])
{
    (void)b;
    (void)h;
    (void)shown;
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
    if (b->frame.time <= 0.0) {
        return;
    }
    const double h = b->frame.time;
    const double k_psi = b->k_torque * b->psi_m;
    const plant_vector_t charge = b->frame.charge;
    b->charge.alpha += charge.alpha;
    b->charge.beta += charge.beta;
    const double squares = b->frame.squares[0] + b->frame.squares[1];
    b->e_copper += b->r_s * squares;
    b->e_switch += b->r_on * squares + b->frame.taken - 1.5 * (b->frame.work[0] + b->frame.work[1]);
    const double early = k_psi * (b->cosine * charge.beta - b->sine * charge.alpha);
    const double drag = b->load + b->direction * b->friction;
    end_t e;
    const bool standing = b->direction == 0.0;
    b->accel = mean_accel(b);
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
    b->frame.time = 0.0;
    bridge_count_turn(b);
}

bridge_integral_t bridge_integral(const bridge_t *b)
{
    plant_vector_t psi = b->psi;
    plant_vector_t charge = b->charge;
    if (b->framed) {
        const plant_vector_t since = b->frame.charge;
        psi = (leg_at_zero(b) == NO_CURRENT)
                  ? magnet(b)
                  : (plant_vector_t){psi.alpha - b->r * since.alpha, psi.beta - b->r * since.beta};
        charge.alpha += since.alpha;
        charge.beta += since.beta;
    }
    /* what the winding has integrated, and what its resistance has lost */
    const double alpha = psi.alpha + b->r_s * charge.alpha;
    const double beta = HALF_SQRT3 * (psi.beta + b->r_s * charge.beta);
    const double mean = b->volt_seconds_0;
    return (bridge_integral_t){{mean + alpha, mean - 0.5 * alpha + beta, mean - 0.5 * alpha - beta}};
}
