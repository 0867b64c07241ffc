#include "plant/switched_inverter_interval.h"

#include "plant/switched_inverter_legs.h"

/* Mean acceleration since the beginning of the interval, weighted as the angle sees it: from the first moment of the torque at
 * constant flux. */
static inline double mean_accel(const switched_inverter_t *inv)
{
    const double h = inv->interval.elapsed;
    if (inv->direction == 0.0 || h <= 0.0) {
        return 0.0;
    }
    const plant_vector_t moment = inv->interval.moment;
    const double first = inv->k_torque * inv->psi_m * (inv->cosine * moment.beta - inv->sine * moment.alpha);
    const double drag = inv->load + inv->direction * inv->friction + inv->viscous * inv->omega;
    return (2.0 * first / (h * h) - drag) * inv->inv_inertia;
}

/* Flux of the magnet at the present angle, which is the flux linkage without current. */
static inline plant_vector_t magnet_flux(const switched_inverter_t *inv)
{
    const double t = inv->interval.elapsed;
    const double x = inv->pole_pairs * t * (inv->omega + 0.5 * t * mean_accel(inv));
    const double c = 1.0 - 0.5 * x * x;
    const double s = x * (1.0 - SIXTH * x * x);
    return (plant_vector_t){inv->psi_m * (inv->cosine * c - inv->sine * s),
                            inv->psi_m * (inv->sine * c + inv->cosine * s)};
}

plant_vector_t inverter_interval_flux(const switched_inverter_t *inv)
{
    const plant_vector_t charge = inv->interval.charge;
    return (leg_at_zero(inv) == ALL_LEGS_ZERO)
               ? magnet_flux(inv)
               : (plant_vector_t){inv->psi.alpha - inv->r * charge.alpha, inv->psi.beta - inv->r * charge.beta};
}

void inverter_interval_end(switched_inverter_t *inv)
{
    inv->in_interval = inv->segment_valid = false;
    inv->trajectory_changed = true;
    if (inv->interval.elapsed <= 0.0) {
        return;
    }
    const double h = inv->interval.elapsed;
    const double k_psi = inv->k_torque * inv->psi_m;
    const plant_vector_t charge = inv->interval.charge;
    inv->charge.alpha += charge.alpha;
    inv->charge.beta += charge.beta;
    const double squares = inv->interval.i_squared[0] + inv->interval.i_squared[1];
    inv->e_copper += inv->r_s * squares;
    inv->e_switch += inv->r_on * squares + inv->interval.energy_drawn -
                     1.5 * (inv->interval.energy_in[0] + inv->interval.energy_in[1]);
    const double early = k_psi * (inv->cosine * charge.beta - inv->sine * charge.alpha);
    const double drag = inv->load + inv->direction * inv->friction;
    step_end_t e;
    const bool standing = inv->direction == 0.0;
    inv->accel = mean_accel(inv);
    inv->jerk = 0.0;
    rotate(inv, h, &e);
    e.psi = (plant_vector_t){inv->psi.alpha - inv->r * charge.alpha, inv->psi.beta - inv->r * charge.beta};
    e.i = current_of(inv, e.inverse, e.psi, e.cosine, e.sine);
    const int zero = leg_at_zero(inv);
    if (zero == ALL_LEGS_ZERO) {
        e.psi = (plant_vector_t){inv->psi_m * e.cosine, inv->psi_m * e.sine};
        e.i = (plant_vector_t){0.0, 0.0};
    } else if (zero >= 0) {
        const plant_vector_t n = phase_axis[zero];
        const plant_vector_t per_n = times(e.inverse, n);
        (void)clear_axis_current(n, per_n, 1.0 / dot(n, per_n), &e);
    }
    const double late = k_psi * (e.cosine * charge.beta - e.sine * charge.alpha);
    e.torque = inv->k_torque * cross(e.psi, e.i);
    const double reluctance =
        (0.5 * h) * (inv->interval.reluctance_torque + e.torque - k_psi * (e.cosine * e.i.beta - e.sine * e.i.alpha));
    const double impulse = 0.5 * (early + late) + reluctance;
    inv->impulse += impulse;
    inv->omega += standing ? 0.0 : (impulse - h * drag - inv->viscous * (e.theta - inv->theta)) * inv->inv_inertia;
    inv->theta = e.theta;
    inv->cosine = e.cosine;
    inv->sine = e.sine;
    inv->inverse = e.inverse;
    inv->psi = e.psi;
    inv->i = e.i;
    inv->torque = e.torque;
    phases_of(inv->i, inv->phase);
    if (zero >= 0 && zero != ALL_LEGS_ZERO) {
        inv->phase[zero] = 0.0;
        inv->phase[(zero + 1) % 3] = -inv->phase[(zero + 2) % 3];
    }
    inv->interval.elapsed = 0.0;
    inverter_count_rotation(inv);
}

#if defined(__GNUC__) && !defined(PLANT_GENERAL) /* a stator vector and its phases in one register */

#include "plant/segment_trajectory.h"

/* Longest interval (without its last segment), longest segment, and longest segment with all legs on one rail, which has no
 * voltage but the back-EMF: in parts of the currents' time constant and of a turn, and not above a PWM period. */
#define INTERVAL_OF_TIME_CONSTANT 0.08
#define DRIVEN_OF_TIME_CONSTANT 0.03
#define IDLE_OF_TIME_CONSTANT 0.05
#define INTERVAL_ANGLE_MAX 0.016 /* electrical [rad] */
#define INTERVAL_MIN 2e-6 /* shorter ones are not worth while [s] */
#define FRICTION_RESERVE 0.05 /* part of the friction kept in reserve, for the reluctance torque */
#define SEGMENT_PARTS_MAX 24 /* parts of one segment */

/* True if the shaft can neither stop nor reach an end stop in an interval, whatever the currents do. */
static inline bool shaft_keeps_moving(const switched_inverter_t *inv)
{
    const double time = 2.0 * LINEAR_INTERVAL_MAX;
    const double i_max = fabs(inv->i.alpha) + fabs(inv->i.beta) + time * inv->u * inv->inv_l_max;
    const double torque =
        inv->k_torque * (inv->psi_m + fabs(inv->l_d - inv->l_q) * i_max) * i_max + fabs(inv->load) + inv->friction;
    const double distance = 2.0 * time * fabs(inv->omega);
    return fabs(inv->omega) > 2.0 * time * torque * inv->inv_inertia && inv->theta - distance > inv->stop_min &&
           inv->theta + distance < inv->stop_max;
}

/* True if friction holds the shaft at standstill against this torque. */
static inline bool friction_holds(const switched_inverter_t *inv, double torque)
{
    return fabs(torque - inv->load) < inv->friction * (1.0 - FRICTION_RESERVE);
}

static inline bool shaft_stands(const switched_inverter_t *inv)
{
    return inv->omega == 0.0 && friction_holds(inv, inv->torque);
}

/* Magnet part of the torque of a current. */
static inline double magnet_torque(const switched_inverter_t *inv, plant_vector_t i)
{
    return inv->k_torque * inv->psi_m * (inv->cosine * i.beta - inv->sine * i.alpha);
}

static inline double smaller(double x, double y) { return (x < y) ? x : y; }

PLANT_AVX2_CLONES bool inverter_interval_start(switched_inverter_t *inv, double u)
{
    inv->u = u;
    const bool standing = shaft_stands(inv);
    if (inv->saturates || inv->locked || inv->held_at_stop || inv->unplugged || inv->shorted ||
        !(standing || shaft_keeps_moving(inv))) {
        return false;
    }
    const double w = inv->pole_pairs * inv->omega;
    const double time_constant = 10.0 * inv->step_max;
    double duration_max = smaller(LINEAR_INTERVAL_MAX, INTERVAL_OF_TIME_CONSTANT * time_constant);
    duration_max = (duration_max * fabs(w) > INTERVAL_ANGLE_MAX) ? INTERVAL_ANGLE_MAX / fabs(w) : duration_max;
    const double driven_max = smaller(duration_max, DRIVEN_OF_TIME_CONSTANT * time_constant);
    if (driven_max < INTERVAL_MIN) {
        return false;
    }
    /* rotor angle in the middle */
    const double x = w * (0.5 * duration_max);
    const double c = inv->cosine * (1.0 - 0.5 * x * x) - inv->sine * x;
    const double s = inv->sine * (1.0 - 0.5 * x * x) + inv->cosine * x;
    const symmetric_matrix_t m = inverse_of(inv, c, s);
    const double l_mean = 0.5 * (inv->l_d + inv->l_q);
    const double l_half = 0.5 * (inv->l_d - inv->l_q) * (c * c - s * s);
    const symmetric_matrix_t l = {l_mean + l_half, (inv->l_d - inv->l_q) * c * s, l_mean - l_half};
    linear_interval_t *interval = &inv->interval;
    interval->duration_max = duration_max;
    interval->segment_max[false] = driven_max;
    interval->segment_max[true] = smaller(duration_max, IDLE_OF_TIME_CONSTANT * time_constant);
    store_lanes(interval->inverse[0], lanes_of(m.aa, m.ab));
    store_lanes(interval->inverse[1], lanes_of(m.ab, m.bb));
    store_lanes(interval->state_matrix[0], lanes_of(-inv->r * m.aa + w * (m.aa * l.ab - m.ab * l.aa),
                                                    -inv->r * m.ab + w * (1.0 + m.ab * l.ab - m.bb * l.aa)));
    store_lanes(interval->state_matrix[1], lanes_of(-inv->r * m.ab - w * (1.0 - m.aa * l.bb + m.ab * l.ab),
                                                    -inv->r * m.bb + w * (m.ab * l.bb - m.bb * l.ab)));
    const double emf = w * inv->psi_m;
    const plant_vector_t emf_term = times(m, (plant_vector_t){emf * inv->sine, -emf * inv->cosine});
    /* growth of the back-EMF at the acceleration of the interval before */
    const double growth = standing ? 0.0 : inv->pole_pairs * inv->psi_m * inv->accel;
    const plant_vector_t emf_term_slope =
        times(m, (plant_vector_t){w * emf * c + growth * s, w * emf * s - growth * c});
    store_lanes(interval->emf_term, lanes_of(emf_term.alpha, emf_term.beta));
    store_lanes(interval->emf_term_slope, lanes_of(emf_term_slope.alpha, emf_term_slope.beta));
    for (int k = 0; k < 3; k++) {
        const plant_vector_t di = times(m, phase_axis[k]);
        store_lanes(interval->di_per_volt[k], lanes_of(2.0 * THIRD * di.alpha, 2.0 * THIRD * di.beta));
        store_lanes(interval->ddi_per_volt[k], product(interval->state_matrix, load_lanes(interval->di_per_volt[k])));
    }
    store_lanes(interval->minus_l_leg, all(-1.0) / (lanes_t){interval->di_per_volt[0][INVERTER_LANE(0)], 1.0,
                                                             interval->di_per_volt[1][INVERTER_LANE(1)],
                                                             interval->di_per_volt[2][INVERTER_LANE(2)]});
    store_lanes(interval->i, (lanes_t){inv->i.alpha, inv->i.beta, inv->phase[1], inv->phase[2]});
    interval->charge = interval->moment = (plant_vector_t){0.0, 0.0};
    store_pair(interval->i_squared, pair_of(0.0));
    store_pair(interval->energy_in, pair_of(0.0));
    interval->energy_drawn = 0.0;
    interval->reluctance_torque = inv->torque - magnet_torque(inv, inv->i);
    interval->elapsed = 0.0;
    inv->direction = standing ? 0.0 : (inv->omega > 0.0) ? 1.0 : -1.0;
    inv->accel = standing ? 0.0
                          : (inv->torque - inv->load - inv->direction * inv->friction - inv->viscous * inv->omega) *
                                inv->inv_inertia;
    inv->jerk = 0.0;
    inv->trajectory_changed = true;
    update_curvature_bounds(inv);
    inv->in_interval = true;
    return true;
}

/* ---- begin a segment -------------------------------------------------------------------------------------------------- */

/* Conduction state; in an interval no leg is shorted. */
PLANT_INLINE void find_conduction(switched_inverter_t *inv)
{
    const unsigned upper = legs_at_upper_rail(inv);
    inv->conduction = (conduction_t){.upper = upper, .reversed = inv->negative, .lower = INVERTER_LEGS & ~upper};
    store_vector(&inv->switch_vector, vector(load_lanes(legs_at[upper])));
}

/* A leg without current takes the voltage that keeps it so, or begins to conduct. */
PLANT_INLINE void settle_at_zero(switched_inverter_t *inv, segment_t *s, int k, double u)
{
    linear_interval_t *interval = &inv->interval;
    const lanes_t di_per_volt = load_lanes(interval->di_per_volt[k]);
    const double needed = phase_of(load_lanes(interval->minus_l_leg) * s->di, k);
    const double lift = settle_leg(inv, k, separate_leg_min(inv, k, u), separate_leg_max(inv, k, u), needed);
    s->v += all(lift) * load_lanes(legs_at[INVERTER_LEG(k)]);
    s->di += all(lift) * di_per_volt;
    s->ddi += all(lift) * load_lanes(interval->ddi_per_volt[k]);
    if (inv->floating >= 0) { /* its voltage has to change for its current to stay at zero */
        interval->floating_slope = phase_of(load_lanes(interval->minus_l_leg) * s->ddi, k);
        s->ddi += all(interval->floating_slope) * di_per_volt;
    } else {
        find_conduction(inv);
    }
}

/* A current begins within an interval: inverter_interval_end subtracts R times the whole charge, so add that of the time before. */
static inline void compensate_earlier_charge(switched_inverter_t *inv)
{
    inv->psi.alpha += inv->r * inv->interval.charge.alpha;
    inv->psi.beta += inv->r * inv->interval.charge.beta;
}

/* With the present gates, from the currents in `s`. */
PLANT_INLINE void begin_segment(switched_inverter_t *inv, segment_t *s, double u)
{
    const linear_interval_t *interval = &inv->interval;
    int k = leg_at_zero(inv);
    inv->non_conducting = false;
    inv->floating = -1;
    inv->u = u;
    inv->segment_valid = true;
    if (k == ALL_LEGS_ZERO) {
        inv->psi = magnet_flux(inv);
        k = inverter_find_conducting_pair(inv, u);
        if (!inv->non_conducting) {
            compensate_earlier_charge(inv);
        }
    }
    find_conduction(inv);
    s->v = all(u) * load_lanes(legs_at[inv->conduction.upper]) + load_lanes(inv->drops[inv->conduction.reversed]);
    if (inv->non_conducting) {
        s->v *= (lanes_t){0.0, 0.0, 1.0, 0.0};
        s->di = s->ddi = all(0.0);
        return;
    }
    const lanes_t emf_term_slope = load_lanes(interval->emf_term_slope);
    s->di = product_plus(interval->state_matrix, s->i,
                         product_plus(interval->inverse, s->v,
                                      load_lanes(interval->emf_term) + all(interval->elapsed) * emf_term_slope));
    s->ddi = product_plus(interval->state_matrix, s->di, emf_term_slope); /* i'' = K i' + e' */
    if (k >= 0) {
        settle_at_zero(inv, s, k, u);
    }
}

PLANT_AVX2_CLONES PLANT_NOINLINE void inverter_interval_begin_segment(switched_inverter_t *inv, double u)
{
    segment_t s = {.i = load_lanes(inv->interval.i)};
    begin_segment(inv, &s, u);
    store_segment(inv, &s);
}

/* ---- advance ---------------------------------------------------------------------------------------------------------- */

/* Length of the segment, at most `rest` [s]. */
static inline double segment_length(const switched_inverter_t *inv, double rest)
{
    const bool idle = (unsigned)(inv->conduction.upper == 0u) | (unsigned)(inv->conduction.upper == INVERTER_LEGS);
    return smaller(rest, inv->interval.segment_max[idle]);
}

/* Shorten *t to the time at which the floating leg's voltage leaves its interval, whose limits follow the bus. Returns the sign
 * of the current that begins then, 0: none. */
static inline int floating_leg_limit(const switched_inverter_t *inv, double u, double *t)
{
    const double low = separate_leg_min(inv, inv->floating, u);
    const double high = separate_leg_max(inv, inv->floating, u);
    const double begin = inv->floating_volts;
    const double end = begin + inv->interval.floating_slope * *t;
    if (end >= low && end <= high) {
        return 0;
    }
    const double at = (((end < low) ? low : high) - begin) / inv->interval.floating_slope;
    *t = (begin > low && begin < high) ? smaller(at, *t) : 0.0;
    return (end < low) ? 1 : -1;
}

/* Outputs of the amplifiers h seconds into the segment: they lag behind the currents of their shunts by tau times the slope that
 * they see by now; the rest of earlier deviations decays exponentially. */
PLANT_INLINE lanes_t amplifier_outputs(const switched_inverter_t *inv, const segment_t *s, double h, lanes_t i,
                                       lanes_t slope)
{
    static const double shares[INVERTER_LEG_SETS][INVERTER_LANES] PLANT_ALIGNED = {
        [LEG_A] = {1, 0, 0, 0},         [LEG_B] = {0, 0, 1, 0},         [LEG_A | LEG_B] = {1, 0, 1, 0},
        [LEG_C] = {0, 0, 0, 1},         [LEG_A | LEG_C] = {1, 0, 0, 1}, [LEG_B | LEG_C] = {0, 0, 1, 1},
        [INVERTER_LEGS] = {1, 0, 1, 1},
    };
    const lanes_t share = load_lanes(shares[inv->conduction.lower]);
    const lanes_t tau = all(inv->tau);
    const lanes_t deviation = load_lanes(inv->amplifier) - share * (s->i - tau * s->di);
    return share * (i - tau * slope) + deviation * all(amplifier_decay(inv, h));
}

PLANT_AVX2_CLONES bool inverter_interval_amplifiers(const switched_inverter_t *inv, double h,
                                                    double shown[INVERTER_LANES])
{
    if (!inv->in_interval || !inv->segment_valid || inv->floating >= 0 || h > segment_length(inv, h)) {
        return false;
    }
    const segment_t s = load_segment(inv);
    trajectory_t c;
    start_trajectory(&c, inv, &s, h);
    store_lanes(shown, amplifier_outputs(inv, &s, h, c.last, slope_at(&c, h)));
    return legs_beyond_zero(c.last, inv->positive, inv->negative) == 0u;
}

/* Add the segment to the sums of the interval, and its charge to *drawn. */
PLANT_INLINE void account_segment(switched_inverter_t *inv, const segment_t *s, const trajectory_t *c,
                                  const zero_crossing_t *crossing, double u, double *drawn)
{
    linear_interval_t *interval = &inv->interval;
    const double t = c->end;
    /* the bus voltage has changed since the segment began */
    const lanes_t v = s->v + all(u - inv->u) * load_lanes(legs_at[inv->conduction.upper]);
    const pair_t before = vector(s->i);
    const pair_t after = vector(c->last);
    pair_t charge =
        pair_of(t) * (before + pair_of(t) * (pair_of(0.5) * vector(s->di) + pair_of(SIXTH * t) * vector(s->ddi)));
    lanes_t impulse = all(t) * v;
    lanes_t slope = slope_at(c, t);
    if (c->crossings > 0) {
        account_crossings(c, crossing, inv, &charge, &impulse, &slope, &interval->energy_drawn);
    }
    store_lanes(inv->amplifier, amplifier_outputs(inv, s, t, c->last, slope));
    if (inv->floating >= 0) {
        impulse += all(0.5 * interval->floating_slope * t * t) * load_lanes(legs_at[INVERTER_LEG(inv->floating)]);
    }
    const double taken = 1.5 * sum(load_vector(&inv->switch_vector) * charge);
    interval->energy_drawn += taken * u;
    *drawn += taken;
    store_pair(interval->i_squared,
               load_pair(interval->i_squared) + pair_of(0.5 * t) * (before * (before + after) + after * after));
    store_pair(interval->energy_in, load_pair(interval->energy_in) + vector(v) * charge);
    const pair_t earlier = load_vector(&interval->charge);
    store_vector(&interval->charge, earlier + charge);
    store_vector(&interval->moment, load_vector(&interval->moment) +
                                        pair_of(t) * (earlier + pair_of(SIXTH * t) * (pair_of(2.0) * before + after)));
    store_vector(&inv->psi, load_vector(&inv->psi) + vector(impulse));
    inv->leg_mean_integral += impulse[LEGS_MEAN];
    interval->elapsed += t;
}

/* Signs and currents at the end of the segment. `zero`: the phase whose current is zero there, -1: none. `sign`: of the current
 * that begins in the leg that has floated, 0: none. */
PLANT_INLINE lanes_t end_segment(switched_inverter_t *inv, const trajectory_t *c, int zero, int sign)
{
    inv->positive = c->positive;
    inv->negative = c->negative;
    if (sign != 0) {
        set_sign(inv, inv->floating, sign);
        return without(c->last, inv->floating);
    }
    if (zero >= 0 && c->floating >= 0) { /* a second current is zero, and with it the third one */
        inv->positive = inv->negative = 0u;
        return all(0.0);
    }
    if (zero >= 0 || c->floating >= 0) {
        const int k = (zero >= 0) ? zero : c->floating;
        set_sign(inv, k, 0);
        return without(c->last, k);
    }
    return c->last;
}

PLANT_INLINE void store_currents(switched_inverter_t *inv, lanes_t i)
{
    store_vector(&inv->i, vector(i));
    inv->phase[0] = i[INVERTER_LANE(0)];
    inv->phase[1] = i[INVERTER_LANE(1)];
    inv->phase[2] = i[INVERTER_LANE(2)];
}

/* At standstill without current an interval may last any time. */
static inline bool is_at_rest(const switched_inverter_t *inv) { return inv->non_conducting && inv->direction == 0.0; }

PLANT_AVX2_CLONES PLANT_NOINLINE double inverter_interval_advance(switched_inverter_t *inv, double *rest, double u)
{
    linear_interval_t *interval = &inv->interval;
    double drawn = 0.0;
    for (int n = 0; n < SEGMENT_PARTS_MAX && *rest > INSTANT; n++) {
        if (!inv->segment_valid) {
            if (!inv->in_interval && !inverter_interval_start(inv, u)) {
                break;
            }
            inverter_interval_begin_segment(inv, u);
        }
        const segment_t s = load_segment(inv);
        trajectory_t c;
        zero_crossing_t crossing[ZERO_CROSSINGS_MAX];
        start_trajectory(&c, inv, &s, segment_length(inv, *rest));
        const int zero = follow_trajectory(&c, crossing, inv, u);
        const int sign = (inv->floating >= 0) ? floating_leg_limit(inv, u, &c.end) : 0;
        if (zero >= 0 || sign != 0) {
            c.last = current_at(&c, c.end);
        }
        if (inv->direction == 0.0 && !friction_holds(inv, magnet_torque(inv, (plant_vector_t){c.last[0], c.last[1]}))) {
            break;
        }
        if (c.end > INSTANT) {
            account_segment(inv, &s, &c, crossing, u, &drawn);
            *rest -= c.end;
        }
        store_lanes(interval->i, end_segment(inv, &c, zero, sign));
        inv->segment_valid = false;
        if (interval->elapsed > 0.99 * interval->duration_max && !is_at_rest(inv)) {
            inverter_interval_end(inv);
        }
    }
    if (*rest > INSTANT && inv->in_interval) {
        inverter_interval_end(inv);
    }
    if (inv->in_interval) {
        store_currents(inv, load_lanes(interval->i));
    }
    inv->e_bus += drawn * u;
    return drawn;
}

#else

bool inverter_interval_start(switched_inverter_t *inv, double u)
{
    (void)inv;
    (void)u;
    return false;
}

void inverter_interval_begin_segment(switched_inverter_t *inv, double u)
{
    (void)inv;
    (void)u;
}

double inverter_interval_advance(switched_inverter_t *inv, double *rest, double u)
{
    (void)inv;
    (void)rest;
    (void)u;
    return 0.0;
}

bool inverter_interval_amplifiers(const switched_inverter_t *inv, double h, double shown[INVERTER_LANES])
{
    (void)inv;
    (void)h;
    (void)shown;
    return false;
}

#endif
