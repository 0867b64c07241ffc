/* bridge_legs.c - which way the currents take through the legs, and how a segment begins. */
#include "plant/bridge_kernel.h"

#define STANDING 1e-9 /* slower is at rest [rad/s] */
#define THRESHOLD 1e-9 /* a torque this close to the friction, relatively, may break loose if it grows */

double bridge_excess(const bridge_t *b, double u, plant_vector_t psi, double omega, int *out, int *back)
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

int bridge_leave_one(bridge_t *b, double u)
{
    int out = 0;
    int back = 0;
    b->positive = b->negative = 0u;
    b->dead = b->unplugged || bridge_excess(b, u, b->psi, b->omega, &out, &back) <= 0.0 || out == back;
    if (b->dead) {
        return -1;
    }
    set_sign(b, out, 1);
    set_sign(b, back, -1);
    return 3 - out - back;
}

/* From rest; a torque that will exceed the friction in no time does so already. */
static bool breaks_loose(const bridge_t *b, double way)
{
    const double rest = (b->torque - b->load) * way - b->friction;
    const double grows = b->dtorque * way;
    const bool goes = rest > 0.0 || (grows > 0.0 && rest > -THRESHOLD * b->friction - 2.0 * INSTANT * grows);
    return goes && open_way(b, way);
}

/* Of motion, from rest. */
static double direction_from_rest(const bridge_t *b)
{
    if (b->locked || b->held) {
        return 0.0;
    }
    const double way = (b->torque > b->load) ? 1.0 : -1.0;
    if (breaks_loose(b, way)) {
        return way;
    }
    return breaks_loose(b, -way) ? -way : 0.0; /* without friction, from an end stop */
}

void bridge_begin_anew(bridge_t *b, double u)
{
    b->floating = -1;
    b->dead = false;
    b->begun = b->moved = true;
    b->u = u;
    find_bend(b);
    int k = leg_at_zero(b);
    if (k == NO_CURRENT) {
        k = bridge_leave_one(b, u);
    }
    find_paths(b);
    if (b->dead) {
        b->a = b->b = b->di = (plant_vector_t){0.0, 0.0};
        b->dtorque = 0.0;
    } else {
        plant_vector_t dpsi = {u * b->a.alpha + b->b.alpha - b->r * b->i.alpha,
                               u * b->a.beta + b->b.beta - b->r * b->i.beta};
        b->di = slope_of(b, dpsi);
        if (k >= 0) {
            const plant_vector_t per_n = times(b->inverse, phase_axis[k]);
            const double needed = -1.5 * dot(phase_axis[k], b->di) / dot(phase_axis[k], per_n);
            const double lift = settle_leg(b, k, lowest(b, k, u), highest(b, k, u), needed);
            const double more = (2.0 / 3.0) * lift;
            const plant_vector_t along = {more * phase_axis[k].alpha, more * phase_axis[k].beta};
            b->di.alpha += more * per_n.alpha;
            b->di.beta += more * per_n.beta;
            dpsi.alpha += along.alpha;
            dpsi.beta += along.beta;
            find_paths(b);
            if (b->floating >= 0) {
                b->b.alpha += along.alpha;
                b->b.beta += along.beta;
                b->level += THIRD * lift;
            }
        }
        b->dtorque = b->k_torque * (cross(dpsi, b->i) + cross(b->psi, b->di));
    }
    if (b->omega > STANDING) {
        b->direction = 1.0;
    } else if (b->omega < -STANDING) {
        b->direction = -1.0;
    } else {
        b->omega = 0.0;
        b->direction = direction_from_rest(b);
        if (b->direction == 0.0) {
            b->accel = 0.0;
            b->jerk = 0.0;
            return;
        }
    }
    b->accel = (b->torque - b->load - b->direction * b->friction - b->viscous * b->omega) * b->inv_inertia;
    b->jerk = b->dtorque * b->inv_inertia;
}

void bridge_begin(bridge_t *b, double u)
{
    if (b->framed || bridge_frame(b, u)) {
        bridge_frame_begin(b, u);
    } else {
        bridge_begin_anew(b, u);
    }
}
