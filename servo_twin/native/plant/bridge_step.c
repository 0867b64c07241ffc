/* bridge_step.c - steps with everything that may happen in them, and where they have to end early. */
#include "plant/bridge_kernel.h"

#define NEAR 3e-7 /* so far a moment is moved by slopes alone [s] */
#define NEVER 1e9 /* [s] */
#define STILL 1e-9 /* of a slope that the bus makes: no slope at all */

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

void bridge_step(const bridge_t *b, double h, double u, end_t *e, double *hold)
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

static void sooner(cut_t *cut, double after, reason_t reason, int phase, int sign)
{
    if (after <= cut->after) {
        *cut = (cut_t){after, reason, phase, sign};
    }
}

/* Straight on, when is the first current down to zero, and which one? One that has just begun, because its leg's voltage has
 * come to an end of the interval, does so without a slope. */
static inline double first_zero(const bridge_t *b, double h, int *phase)
{
    double slope[3];
    phases_of(b->di, slope);
    const double still = STILL * (b->u + b->v_drop) * b->inv_l_most;
    double first = h;
    for (int k = 0; k < 3; k++) {
        const double falls = -slope[k] * sign_of(b, k);
        const double size = b->phase[k] * sign_of(b, k);
        if (falls > ((size > NOTHING) ? 0.0 : still) && size < falls * first) {
            first = size / falls;
            *phase = k;
        }
    }
    return (first > 0.0) ? first : 0.0;
}

/* Seconds from the end of a step to the nearest zero of a current (before or after it), by the slope there: of the one
 * that was expected to come first, and of those that are beyond it. Its phase is expected from then on. */
static double to_zero(const bridge_t *b, const end_t *e, double h, int *expected)
{
    double slope[3];
    double early[3];
    const double twice_per_h = 2.0 / h;
    const plant_vector_t late = {twice_per_h * (e->i.alpha - b->i.alpha) - b->di.alpha,
                                 twice_per_h * (e->i.beta - b->i.beta) - b->di.beta};
    double nearest = NEVER;
    int phase = *expected;
    phases_of(late, slope);
    phases_of(b->di, early);
    for (int k = 0; k < 3; k++) {
        const int sign = sign_of(b, k);
        const double falls = -slope[k] * sign;
        const double size = e->phase[k] * sign;
        double way = NEVER;
        if (falls > 0.0 && (k == *expected || size < 0.0)) {
            way = size / falls;
        } else if (size < 0.0) { /* on its way back already */
            way = root_of(b->phase[k] * sign, early[k] * sign, size, h) - h;
        }
        if (way < nearest) {
            nearest = way;
            phase = k;
        }
    }
    *expected = phase;
    return nearest;
}

void bridge_shift(const bridge_t *b, double h, double t, end_t *e)
{
    const double per_h = 1.0 / h;
    const double u_alpha = (e->psi.alpha - b->psi.alpha + b->r * e->charge.alpha) * per_h; /* mean voltage */
    const double u_beta = (e->psi.beta - b->psi.beta + b->r * e->charge.beta) * per_h;
    const double x = b->pole_pairs * b->omega * t;
    const double cosine = e->cosine;
    e->theta += b->omega * t;
    e->cosine -= e->sine * x;
    e->sine += cosine * x;
    e->charge.alpha += e->i.alpha * t;
    e->charge.beta += e->i.beta * t;
    e->psi.alpha += (u_alpha - b->r * e->i.alpha) * t;
    e->psi.beta += (u_beta - b->r * e->i.beta) * t;
    e->inverse = inverse_of(b, e->cosine, e->sine);
    e->i = current_of(b, e->inverse, e->psi, e->cosine, e->sine);
    phases_of(e->i, e->phase);
    e->torque = b->k_torque * cross(e->psi, e->i);
    e->omega += b->accel * t;
}

/* Moment at which the shaft stops, breaks loose or meets an end stop. */
static void find_jerk(const bridge_t *b, double h, const end_t *e, cut_t *cut)
{
    if (e->theta > b->high) {
        sooner(cut, root_of(b->high - b->theta, -b->omega, b->high - e->theta, h), ENDED, 0, 1);
    } else if (e->theta < b->low) {
        sooner(cut, root_of(b->theta - b->low, b->omega, e->theta - b->low, h), ENDED, 0, -1);
    } else if (e->omega * b->direction < 0.0) {
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
    const double late = bridge_excess(b, u, e->psi, e->omega, &out, &back);
    if (late > 0.0) {
        const double early = bridge_excess(b, u, b->psi, b->omega, &out, &back);
        sooner(cut, h * ((early < 0.0) ? early / (early - late) : 0.0), CLAMPED, -1, 0);
    }
}

/* Steps that end nearer and nearer to a zero, unless it turns out to be beyond h. Returns what is left to go. */
static double approach_zero(const bridge_t *b, double h, double u, double *t, int *expected, end_t *e, double *hold)
{
    const double near = (b->floating >= 0) ? INSTANT : NEAR; /* its shift would need the leg's voltage */
    double more = to_zero(b, e, *t, expected);
    for (int n = 0; n < 3 && fabs(more) > near && *t + more < h && *t + more > 0.0; n++) {
        *t += more;
        bridge_step(b, *t, u, e, hold);
        more = to_zero(b, e, *t, expected);
    }
    return more;
}

cut_t bridge_step_to_change(const bridge_t *b, double h, double u, end_t *e)
{
    double hold = 0.0;
    int expected = -1;
    double t = b->dead ? h : first_zero(b, h, &expected);
    if (t < INSTANT && t < h) { /* a current at zero that would leave it the wrong way */
        *e = (end_t){.psi = b->psi};
        return (cut_t){0.0, CURRENT_ZERO, expected, 0};
    }
    cut_t cut = {t, WHOLE, 0, 0};
    bridge_step(b, t, u, e, &hold);
    if (b->dead) {
        find_conduction(b, t, u, e, &cut);
    } else if (t < h || crossed(b, e)) {
        double more = approach_zero(b, h, u, &t, &expected, e, &hold);
        if (t + more >= h) { /* curvature has saved it, if no other current */
            t = cut.after = h;
            expected = -1;
            bridge_step(b, t, u, e, &hold);
            more = crossed(b, e) ? approach_zero(b, h, u, &t, &expected, e, &hold) : NEVER;
        }
        if (t + more < h) {
            more = (t + more > 0.0) ? more : 0.0;
            if (b->floating < 0) {
                bridge_shift(b, t, more, e);
                t += more;
            }
            cut = (cut_t){t, CURRENT_ZERO, expected, 0};
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
            bridge_step(b, first.after, u, e, &hold);
        }
    }
    return first;
}
