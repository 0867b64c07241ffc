#include "plant/switched_inverter_step.h"

#define SHIFT_MAX 3e-7 /* longest time that an end is moved by slopes alone [s] */
#define NEVER 1e9 /* [s] */
#define SLOPE_MIN 1e-9 /* slope of a current that counts as zero, relative to the one that the bus makes */

/* ---- one step --------------------------------------------------------------------------------------------------------- */

/* Torque and speed at the end, from the currents there. */
PLANT_INLINE void update_speed(const switched_inverter_t *inv, double h, step_end_t *e)
{
    e->torque = inv->k_torque * cross(e->psi, e->i);
    const double impulse = (THIRD * h) * (2.0 * inv->torque + (0.5 * h) * inv->dtorque + e->torque);
    const double drag = h * (inv->load + inv->direction * inv->friction) + inv->viscous * (e->theta - inv->theta);
    e->omega = (inv->direction != 0.0) ? inv->omega + (impulse - drag) * inv->inv_inertia : 0.0;
}

/* First estimate of charge and end with a current that is linear in time; `drive` is the integral of the legs' voltage [V s]. */
PLANT_INLINE void estimate_linear(const switched_inverter_t *inv, double h, plant_vector_t drive, step_end_t *e)
{
    e->charge =
        (plant_vector_t){h * (inv->i.alpha + (0.5 * h) * inv->di.alpha), h * (inv->i.beta + (0.5 * h) * inv->di.beta)};
    e->psi.alpha = inv->psi.alpha + drive.alpha - inv->r * e->charge.alpha;
    e->psi.beta = inv->psi.beta + drive.beta - inv->r * e->charge.beta;
    e->i = current_of(inv, e->inverse, e->psi, e->cosine, e->sine);
}

/* Correction by the curvature of the current, which changes flux and current in proportion. */
PLANT_INLINE void add_curvature(const switched_inverter_t *inv, double h, step_end_t *e)
{
    const double third = THIRD * h;
    const plant_vector_t charge = {third * (e->i.alpha - inv->i.alpha - h * inv->di.alpha),
                                   third * (e->i.beta - inv->i.beta - h * inv->di.beta)};
    const plant_vector_t flux = {inv->r * charge.alpha, inv->r * charge.beta};
    const plant_vector_t current = times(e->inverse, flux);
    e->charge.alpha += charge.alpha;
    e->charge.beta += charge.beta;
    e->psi.alpha -= flux.alpha;
    e->psi.beta -= flux.beta;
    e->i.alpha -= current.alpha;
    e->i.beta -= current.beta;
}

static void step_conducting(const switched_inverter_t *inv, double h, plant_vector_t drive, step_end_t *e)
{
    rotate(inv, h, e);
    estimate_linear(inv, h, drive, e);
    add_curvature(inv, h, e);
    phases_of(e->i, e->phase);
    update_speed(inv, h, e);
}

/* With one leg floating. Returns the mean of its voltage as an offset from that in `drive` [V]. */
PLANT_INLINE double step_floating(const switched_inverter_t *inv, double h, plant_vector_t drive, step_end_t *e)
{
    const int k = inv->floating;
    const plant_vector_t n = phase_axis[k];
    rotate(inv, h, e);
    const plant_vector_t per_n = times(e->inverse, n);
    const double per_l = 1.0 / dot(n, per_n);
    estimate_linear(inv, h, drive, e);
    double lift = clear_axis_current(n, per_n, per_l, e);
    add_curvature(inv, h, e);
    lift += clear_axis_current(n, per_n, per_l, e);
    phases_of(e->i, e->phase);
    e->phase[k] = 0.0;
    e->phase[(k + 1) % 3] = -e->phase[(k + 2) % 3];
    update_speed(inv, h, e);
    return 1.5 * lift / h;
}

/* Without any current. */
static void step_non_conducting(const switched_inverter_t *inv, double h, step_end_t *e)
{
    rotate(inv, h, e);
    e->omega = inv->omega + h * (inv->accel + 0.5 * h * inv->jerk);
    e->psi.alpha = inv->psi_m * e->cosine;
    e->psi.beta = inv->psi_m * e->sine;
    e->i = e->charge = (plant_vector_t){0.0, 0.0};
    e->phase[0] = e->phase[1] = e->phase[2] = 0.0;
    e->torque = 0.0;
}

void inverter_general_step(const switched_inverter_t *inv, double h, double u, step_end_t *e, double *floating_volts)
{
    const plant_vector_t drive = {h * (u * inv->switch_vector.alpha + inv->drop_vector.alpha),
                                  h * (u * inv->switch_vector.beta + inv->drop_vector.beta)};
    if (inv->non_conducting) {
        step_non_conducting(inv, h, e);
    } else if (inv->floating >= 0) { /* nearly linear in time: the end differs by twice the mean's difference */
        *floating_volts = inv->floating_volts + 2.0 * step_floating(inv, h, drive, e);
    } else {
        step_conducting(inv, h, drive, e);
    }
}

/* Move the end of a step of length h by a very short time t, forwards or backwards. */
static void shift_end(const switched_inverter_t *inv, double h, double t, step_end_t *e)
{
    const double per_h = 1.0 / h;
    const double u_alpha = (e->psi.alpha - inv->psi.alpha + inv->r * e->charge.alpha) * per_h; /* mean voltage */
    const double u_beta = (e->psi.beta - inv->psi.beta + inv->r * e->charge.beta) * per_h;
    const double x = inv->pole_pairs * inv->omega * t;
    const double cosine = e->cosine;
    e->theta += inv->omega * t;
    e->cosine -= e->sine * x;
    e->sine += cosine * x;
    e->charge.alpha += e->i.alpha * t;
    e->charge.beta += e->i.beta * t;
    e->psi.alpha += (u_alpha - inv->r * e->i.alpha) * t;
    e->psi.beta += (u_beta - inv->r * e->i.beta) * t;
    e->inverse = inverse_of(inv, e->cosine, e->sine);
    e->i = current_of(inv, e->inverse, e->psi, e->cosine, e->sine);
    phases_of(e->i, e->phase);
    e->torque = inv->k_torque * cross(e->psi, e->i);
    e->omega += inv->accel * t;
}

/* ---- events ----------------------------------------------------------------------------------------------------------- */

static inline bool current_crossed_zero(const switched_inverter_t *inv, const step_end_t *e)
{
    return e->phase[0] * sign_of(inv, 0) < -CURRENT_EPS || e->phase[1] * sign_of(inv, 1) < -CURRENT_EPS ||
           e->phase[2] * sign_of(inv, 2) < -CURRENT_EPS;
}

/* The shaft has stopped, started or reached an end stop. */
static inline bool motion_changed(const switched_inverter_t *inv, const step_end_t *e)
{
    return e->omega * inv->direction < 0.0 || e->theta > inv->stop_max || e->theta < inv->stop_min ||
           (inv->direction == 0.0 && !inv->locked && fabs(e->torque - inv->load) > inv->friction &&
            direction_is_free(inv, e->torque - inv->load));
}

static void limit_step(step_limit_t *limit, double duration, step_reason_t reason, int phase, int sign)
{
    if (duration <= limit->duration) {
        *limit = (step_limit_t){duration, reason, phase, sign};
    }
}

/* First current zero crossing by linear extrapolation, and its phase. A current that has just begun, because the voltage of its
 * leg has reached a limit, begins without a slope. */
static inline double first_zero_by_slope(const switched_inverter_t *inv, double h, int *phase)
{
    double slope[3];
    phases_of(inv->di, slope);
    const double slope_min = SLOPE_MIN * (inv->u + inv->v_drop) * inv->inv_l_max;
    double first = h;
    for (int k = 0; k < 3; k++) {
        const double falls = -slope[k] * sign_of(inv, k);
        const double size = inv->phase[k] * sign_of(inv, k);
        if (falls > ((size > CURRENT_EPS) ? 0.0 : slope_min) && size < falls * first) {
            first = size / falls;
            *phase = k;
        }
    }
    return (first > 0.0) ? first : 0.0;
}

/* Time from the end of a step to the nearest current zero crossing, before or after it, by the slope at the end. Considers the
 * expected phase and those that have crossed; updates the expected phase. */
static double time_to_zero(const switched_inverter_t *inv, const step_end_t *e, double h, int *expected)
{
    double slope[3];
    double early[3];
    const double twice_per_h = 2.0 / h;
    const plant_vector_t late = {twice_per_h * (e->i.alpha - inv->i.alpha) - inv->di.alpha,
                                 twice_per_h * (e->i.beta - inv->i.beta) - inv->di.beta};
    double nearest = NEVER;
    int phase = *expected;
    phases_of(late, slope);
    phases_of(inv->di, early);
    for (int k = 0; k < 3; k++) {
        const int sign = sign_of(inv, k);
        const double falls = -slope[k] * sign;
        const double size = e->phase[k] * sign;
        double t = NEVER;
        if (falls > 0.0 && (k == *expected || size < 0.0)) {
            t = size / falls;
        } else if (size < 0.0) { /* beyond zero, but returning */
            t = root_of(inv->phase[k] * sign, early[k] * sign, size, h) - h;
        }
        if (t < nearest) {
            nearest = t;
            phase = k;
        }
    }
    *expected = phase;
    return nearest;
}

/* Steps with ends closer and closer to a zero crossing, unless it turns out to be beyond h. Returns the time that is left. */
static double approach_zero(const switched_inverter_t *inv, double h, double u, double *t, int *expected, step_end_t *e,
                            double *floating_volts)
{
    /* shift_end does not cover the voltage of a floating leg */
    const double close = (inv->floating >= 0) ? INSTANT : SHIFT_MAX;
    double remaining = time_to_zero(inv, e, *t, expected);
    for (int n = 0; n < 3 && fabs(remaining) > close && *t + remaining < h && *t + remaining > 0.0; n++) {
        *t += remaining;
        inverter_general_step(inv, *t, u, e, floating_volts);
        remaining = time_to_zero(inv, e, *t, expected);
    }
    return remaining;
}

/* When the shaft stops, starts or reaches an end stop. */
static void find_motion_change(const switched_inverter_t *inv, double h, const step_end_t *e, step_limit_t *limit)
{
    if (e->theta > inv->stop_max) {
        limit_step(limit, root_of(inv->stop_max - inv->theta, -inv->omega, inv->stop_max - e->theta, h), STEP_END_STOP,
                   0, 1);
    } else if (e->theta < inv->stop_min) {
        limit_step(limit, root_of(inv->theta - inv->stop_min, inv->omega, e->theta - inv->stop_min, h), STEP_END_STOP,
                   0, -1);
    } else if (e->omega * inv->direction < 0.0) {
        const double direction = inv->direction;
        limit_step(limit, root_of(inv->omega * direction, inv->accel * direction, e->omega * direction, h),
                   STEP_SHAFT_STOPPED, 0, 0);
    } else if (!inv->held_at_stop) {
        const double direction = (e->torque > inv->load) ? 1.0 : -1.0;
        const double after = inv->friction - (e->torque - inv->load) * direction;
        const double before = inv->friction - (inv->torque - inv->load) * direction;
        limit_step(limit, root_of(before, -inv->dtorque * direction, after, h), STEP_SHAFT_STARTED, 0, 0);
    }
}

/* When the voltage of the floating leg, `floating_volts` at the end, leaves its interval. */
static void find_leg_limit(const switched_inverter_t *inv, double h, double u, double floating_volts,
                           step_limit_t *limit)
{
    const int k = inv->floating;
    const double begin = inv->floating_volts;
    const double low = leg_min(inv, k, u);
    const double high = leg_max(inv, k, u);
    if (floating_volts < low) {
        limit_step(limit, h * ((begin > low) ? (begin - low) / (begin - floating_volts) : 0.0), STEP_LEG_LIMIT, k, 1);
    } else if (floating_volts > high) {
        limit_step(limit, h * ((begin < high) ? (high - begin) / (floating_volts - begin) : 0.0), STEP_LEG_LIMIT, k,
                   -1);
    }
}

/* Without current: when the back-EMF exceeds the voltage that the diodes block. */
static void find_conduction(const switched_inverter_t *inv, double h, double u, const step_end_t *e,
                            step_limit_t *limit)
{
    int source = 0;
    int sink = 0;
    if (inv->unplugged) {
        return;
    }
    const double late = inverter_blocking_excess(inv, u, e->psi, e->omega, &source, &sink);
    if (late > 0.0) {
        const double early = inverter_blocking_excess(inv, u, inv->psi, inv->omega, &source, &sink);
        limit_step(limit, h * ((early < 0.0) ? early / (early - late) : 0.0), STEP_LEG_LIMIT, -1, 0);
    }
}

step_limit_t inverter_general_step_to_event(const switched_inverter_t *inv, double h, double u, step_end_t *e)
{
    double floating_volts = 0.0;
    int expected = -1;
    double t = inv->non_conducting ? h : first_zero_by_slope(inv, h, &expected);
    if (t < INSTANT && t < h) { /* a current at zero with a slope against its sign */
        *e = (step_end_t){.psi = inv->psi};
        return (step_limit_t){0.0, STEP_CURRENT_ZERO, expected, 0};
    }
    step_limit_t limit = {t, STEP_COMPLETE, 0, 0};
    inverter_general_step(inv, t, u, e, &floating_volts);
    if (inv->non_conducting) {
        find_conduction(inv, t, u, e, &limit);
    } else if (t < h || current_crossed_zero(inv, e)) {
        double remaining = approach_zero(inv, h, u, &t, &expected, e, &floating_volts);
        if (t + remaining >= h) { /* by its curvature this current stays off zero; another one may not */
            t = limit.duration = h;
            expected = -1;
            inverter_general_step(inv, t, u, e, &floating_volts);
            remaining =
                current_crossed_zero(inv, e) ? approach_zero(inv, h, u, &t, &expected, e, &floating_volts) : NEVER;
        }
        if (t + remaining < h) {
            remaining = (t + remaining > 0.0) ? remaining : 0.0;
            if (inv->floating < 0) {
                shift_end(inv, t, remaining, e);
                t += remaining;
            }
            limit = (step_limit_t){t, STEP_CURRENT_ZERO, expected, 0};
        }
    }
    step_limit_t first = {t, limit.reason, limit.phase, limit.sign};
    first.duration = (limit.reason == STEP_LEG_LIMIT) ? limit.duration : t;
    if (inv->floating >= 0) {
        find_leg_limit(inv, t, u, floating_volts, &first);
    }
    if (motion_changed(inv, e)) {
        find_motion_change(inv, t, e, &first);
    }
    if (first.duration < t) {
        first.duration = (first.duration < INSTANT) ? 0.0 : first.duration;
        if (first.duration > 0.0) {
            inverter_general_step(inv, first.duration, u, e, &floating_volts);
        }
    }
    return first;
}
