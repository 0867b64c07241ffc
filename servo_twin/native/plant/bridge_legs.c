/* bridge_legs.c - which way the currents take through the legs, and how a segment begins. */
#include "plant/bridge_kernel.h"

#define STANDING 1e-9 /* slower is at rest [rad/s] */
#define THRESHOLD 1e-9 /* a torque this close to the friction, relatively, may break loose if it grows */

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
        b->dead = b->unplugged || bridge_excess(b, u, b->psi, b->omega, &out, &back) <= 0.0 || out == back;
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
    const bool goes = rest > 0.0 || (rest > -THRESHOLD * b->friction && b->dtorque * way > 0.0);
    return (goes && open_way(b, way)) ? way : 0.0;
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
