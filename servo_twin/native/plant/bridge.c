#include <string.h>

#include "plant/bridge_kernel.h"
#include "plant/decay.h"

#define SPLITS 24 /* parts of one segment; the rest of it is taken in one piece */
#define CURVED 0.75 /* half of i'' h^2, and as much again of that for what is beyond */
#define NEAR 0.5e-6 /* so soon a current has hardly left the slope that it began with [s] */
#define FAR 1e9 /* voltage that no leg comes to [V] */
#define IRON_LONGEST 5e-6 /* in which saturated iron hardly changes [s] */
#define FRESH_TRIG 64u /* turns of sine and cosine until they are evaluated afresh */

/* Where the rotor looks, from its angle. */
static void face(bridge_t *b)
{
    plant_sincos(b->pole_pairs * b->theta, &b->sine, &b->cosine);
    b->inverse = inverse_of(b, b->cosine, b->sine);
}

void bridge_count_turn(bridge_t *b)
{
    if (++b->turns >= FRESH_TRIG) {
        b->turns = 0;
        face(b);
    }
}

static bool is_open(const bridge_t *b, int k) { return b->reach[k] >= FAR; }

static void set_drop(bridge_t *b, double v_drop)
{
    b->v_drop = v_drop;
    for (int k = 0; k < 3; k++) {
        b->reach[k] = is_open(b, k) ? FAR : v_drop;
    }
    /* without current out of the motor a leg is one drop lower */
    for (unsigned legs = 0; legs < BRIDGE_LEG_SETS; legs++) {
        for (int lane = 0; lane < BRIDGE_LANES; lane++) {
            b->drops[legs][lane] = 2.0 * v_drop * legs_at[legs][lane];
        }
        b->drops[legs][LEGS_MEAN] -= v_drop;
    }
}

static void set_inductances(bridge_t *b, double l_d, double l_q)
{
    b->inv_l_mean = 0.5 / l_d + 0.5 / l_q;
    b->inv_l_half = 0.5 / l_d - 0.5 / l_q;
    const double inv_l_least = b->inv_l_mean - fabs(b->inv_l_half);
    b->inv_l_most = b->inv_l_mean + fabs(b->inv_l_half);
    b->saliency = b->inv_l_most / inv_l_least;
    const double aside = (0.5 * b->inv_l_mean + fabs(b->inv_l_half)) / inv_l_least;
    b->coupling = aside + aside * aside; /* straight, or by way of the third phase */
}

static plant_vector_t to_rotor(plant_vector_t x, double c, double s)
{
    return (plant_vector_t){x.alpha * c + x.beta * s, x.beta * c - x.alpha * s};
}

static plant_vector_t to_stator(plant_vector_t x, double c, double s)
{
    return (plant_vector_t){x.alpha * c - x.beta * s, x.beta * c + x.alpha * s};
}

plant_vector_t bridge_iron_current(const bridge_t *b, plant_vector_t psi, double c, double s)
{
    const plant_vector_t flux = to_rotor(psi, c, s);
    const plant_vector_t i = {saturation_current(iron_d(b), flux.alpha - b->psi_m),
                              saturation_current(iron_q(b), flux.beta)};
    return to_stator(i, c, s);
}

/* Inductances for small changes of the present flux. */
static void tune_iron(bridge_t *b)
{
    const plant_vector_t flux = to_rotor(b->psi, b->cosine, b->sine);
    set_inductances(b, saturation_inductance(iron_d(b), flux.alpha - b->psi_m),
                    saturation_inductance(iron_q(b), flux.beta));
    b->inverse = inverse_of(b, b->cosine, b->sine);
}

/* All that the configuration says but where the shaft is, and how the amplifiers settle. */
static void set_parameters(bridge_t *b, const plant_axis_t *config, double r_s)
{
    set_drop(b, config->v_drop);
    b->l_d = config->l_d;
    b->l_q = config->l_q;
    b->per_s_d = saturation_of(config->l_d, config->i_saturation_d).per_s;
    b->per_s_q = saturation_of(config->l_q, config->i_saturation_q).per_s;
    b->saturates = config->i_saturation_d > 0.0 || config->i_saturation_q > 0.0;
    set_inductances(b, config->l_d, config->l_q);
    b->r_on = config->r_on;
    bridge_set_winding(b, r_s);
    b->psi_m = config->psi_m;
    b->pole_pairs = config->pole_pairs;
    b->k_torque = 1.5 * config->pole_pairs;
    b->inv_inertia = 1.0 / config->inertia;
    b->viscous = config->viscous;
    b->longest = 0.1 * ((config->l_d < config->l_q) ? config->l_d : config->l_q) / (config->r_s + config->r_on);
    b->longest = (b->saturates && b->longest > IRON_LONGEST) ? IRON_LONGEST : b->longest;
}

void bridge_init(bridge_t *bridge, const plant_axis_t *config)
{
    *bridge = (bridge_t){
        .friction = config->friction,
        .load = config->load_torque,
        .tau = config->i_settle,
        .theta = config->theta_start,
        .low = -INFINITY,
        .high = INFINITY,
        .moved = true,
        .own = BRIDGE_LEGS,
        .shorted_leg = -1,
        .shorted_beside = -1,
        .grounded = -1,
        .alone = -1,
    };
    set_parameters(bridge, config, config->r_s);
    const double x = (config->i_settle > 0.0) ? 1.0 / (BRIDGE_CLOCK_HZ * config->i_settle) : 800.0;
    for (int n = 0; n < BRIDGE_DECAY; n++) {
        bridge->decay_fine[n] = plant_decay(n * x);
        bridge->decay_coarse[n] = plant_decay(n * BRIDGE_DECAY * x);
    }
    face(bridge);
    bridge->psi.alpha = bridge->psi_m * bridge->cosine;
    bridge->psi.beta = bridge->psi_m * bridge->sine;
}

/* ---- moving on ---------------------------------------------------------------------------------------------------- */

/* The amplifiers, h seconds on, behind currents that go straight to `phase`. */
static void filter(bridge_t *b, double h, const double phase[3])
{
    const double left = decay(b, h);
    const double tau_h = b->tau / h;
    for (int k = 0; k < 3; k++) {
        const double seen = (b->paths.lower & BRIDGE_LEG(k)) != 0u ? 1.0 : 0.0;
        double *shown = &b->amplifier[BRIDGE_LANE(k)];
        *shown = lag_behind(*shown, seen * b->phase[k], seen * phase[k], tau_h, left);
    }
}

double bridge_accept(bridge_t *b, double h, double u_h, const end_t *e)
{
    const double charge = 1.5 * dot(b->a, e->charge);
    const double squares = (0.5 * h) * (dot(b->i, b->i) + dot(b->i, e->i) + dot(e->i, e->i)); /* 3/2 int i^2 */
    filter(b, h, e->phase);
    b->e_copper += b->r_s * squares;
    b->e_switch += b->r_on * squares - 1.5 * dot(b->b, e->charge);
    b->e_bus += charge * u_h / h;
    b->charge.alpha += e->charge.alpha;
    b->charge.beta += e->charge.beta;
    b->volt_seconds_0 += b->level * h;
    b->psi = e->psi;
    b->i = e->i;
    b->theta = e->theta;
    b->omega = e->omega;
    b->cosine = e->cosine;
    b->sine = e->sine;
    b->inverse = e->inverse;
    b->torque = e->torque;
    b->phase[0] = e->phase[0];
    b->phase[1] = e->phase[1];
    b->phase[2] = e->phase[2];
    b->begun = false;
    if (b->saturates) {
        tune_iron(b);
    }
    bridge_count_turn(b);
    return charge;
}

/* Flux and torque of the present currents. */
static void flux_follows(bridge_t *b)
{
    double d = b->l_d * (b->i.alpha * b->cosine + b->i.beta * b->sine);
    double q = b->l_q * (b->i.beta * b->cosine - b->i.alpha * b->sine);
    if (b->saturates) {
        d = saturation_flux(iron_d(b), d / b->l_d);
        q = saturation_flux(iron_q(b), q / b->l_q);
    }
    d += b->psi_m;
    b->psi.alpha = d * b->cosine - q * b->sine;
    b->psi.beta = d * b->sine + q * b->cosine;
    b->torque = b->k_torque * cross(b->psi, b->i);
}

void bridge_remove_phase(bridge_t *b, int k)
{
    const double i_k = dot(b->i, phase_axis[k]);
    b->i.alpha -= i_k * phase_axis[k].alpha;
    b->i.beta -= i_k * phase_axis[k].beta;
    phases_of(b->i, b->phase);
    b->phase[k] = 0.0;
    b->phase[(k + 1) % 3] = -b->phase[(k + 2) % 3];
    flux_follows(b);
}

void bridge_remove_all(bridge_t *b)
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
            bridge_remove_all(b);
        } else {
            bridge_remove_phase(b, cut->phase);
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
    case ENDED:
        b->held = cut->after <= 0.0;
        b->theta = (cut->sign > 0) ? b->high : b->low; /* a parabola has brought it nearly there */
        b->omega = 0.0;
        face(b);
        flux_follows(b);
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
    const int most = SPLITS * (1 + (int)(h / b->longest));
    for (int n = 0; rest > INSTANT; n++) {
        end_t e;
        double hold;
        const double part = (rest < b->longest) ? rest : b->longest;
        cut_t cut = {part, WHOLE, 0, 0};
        if (!b->begun) {
            bridge_begin_anew(b, u);
        }
        if (n < most) {
            cut = bridge_step_to_change(b, part, u, &e);
        } else {
            bridge_step(b, part, u, &e, &hold);
            if (e.theta > b->high || e.theta < b->low) {
                cut = (cut_t){part, ENDED, 0, (e.theta > b->high) ? 1 : -1};
            }
        }
        if (cut.after > 0.0) {
            charge += bridge_accept(b, cut.after, u * cut.after, &e);
        }
        b->begun = false;
        apply(b, &cut);
        rest -= cut.after;
    }
    b->held = false;
    return charge;
}

double bridge_advance(bridge_t *b, double h, double u)
{
    double rest = h;
    if (bridge_is_stale(b, u)) {
        bridge_settle(b);
        bridge_begin_again(b);
    }
    const double charge = (b->framed || !b->begun) ? bridge_frame_advance(b, &rest, u) : 0.0;
    return (rest > INSTANT) ? charge + split_advance(b, rest, u) : charge;
}

/* ---- what others want to know ------------------------------------------------------------------------------------- */

bool bridge_amplifiers(const bridge_t *b, double h, double u, double shown[BRIDGE_LANES])
{
    if (h <= 0.0) {
        memcpy(shown, b->amplifier, sizeof b->amplifier);
        return true;
    }
    if (bridge_is_stale(b, u)) {
        return false;
    }
    if (bridge_foresee(b, h, shown)) {
        return true;
    }
    if (h > NEAR) {
        return false;
    }
    const double left = decay(b, h);
    for (int k = 0; k < 3; k++) {
        const double seen = (b->paths.lower & BRIDGE_LEG(k)) != 0u ? 1.0 : 0.0;
        const double slope = dot(b->di, phase_axis[k]);
        const double begin = seen * (b->phase[k] - b->tau * slope);
        shown[BRIDGE_LANE(k)] = begin + seen * h * slope + (b->amplifier[BRIDGE_LANE(k)] - begin) * left;
    }
    return true;
}

double bridge_shunt(const bridge_t *b, int k) { return (b->paths.lower & BRIDGE_LEG(k)) != 0u ? b->phase[k] : 0.0; }

/* Without current: true if none begins with other gates, all off in their leg if it `opens`. */
static bool stays_dead(bridge_t *b, bool opens, unsigned gates)
{
    if (opens && b->direction == 0.0) {
        return true; /* its interval grows, and there is no back-EMF */
    }
    const unsigned before = b->gates;
    int out = 0;
    int back = 0;
    b->gates = gates;
    const bool dead = b->unplugged || bridge_excess(b, b->u, b->psi, b->omega, &out, &back) <= 0.0;
    b->gates = before;
    return dead;
}

/* A floating leg loses its last gate: what it may do without is more than with one, so it floats on, provided that it has
 * not left its old interval meanwhile. Its voltage follows the back-EMF, so it changes by 3/2 w^2 psi_m at most. */
static bool floats_on(const bridge_t *b, int k, double h)
{
    const double w = b->pole_pairs * b->omega;
    const double drift = 2.0 * h * w * w * b->psi_m;
    return b->hold - drift > lowest(b, k, b->u) && b->hold + drift < highest(b, k, b->u);
}

bool bridge_indifferent(bridge_t *b, int k, unsigned gates, double h, double u)
{
    static const double side[BRIDGE_LEG_SETS][3] = {
        [0] = {1, 1, 1},
        [LEG_A] = {-1, 1, 1},
        [LEG_B] = {1, -1, 1},
        [LEG_A | LEG_B] = {-1, -1, 1},
        [LEG_C] = {1, 1, -1},
        [LEG_A | LEG_C] = {-1, 1, -1},
        [LEG_B | LEG_C] = {1, -1, -1},
        [BRIDGE_LEGS] = {-1, -1, -1},
    };
    const unsigned leg = BRIDGE_LEG(k);
    const bool opens = (gates & BRIDGE_BOTH(leg)) == 0u;
    if (!b->begun || b->shorted) {
        return false;
    }
    if (b->dead) {
        return stays_dead(b, opens, gates);
    }
    if (b->saturates) {
        return false; /* how far its currents bend is not known beforehand */
    }
    /* the diode across the other switch conducts, whether its gate is on or off */
    if (((b->gates ^ gates) & (b->positive | b->negative << BRIDGE_LOWER)) != 0u || bridge_is_stale(b, u)) {
        return false;
    }
    const bool floats = ((b->positive | b->negative) & leg) == 0u;
    if (floats && (!opens || !floats_on(b, k, h))) {
        return false;
    }
    /* Straight on, where are the currents? And how far may they have bent: i'' = K i' + e', as bridge_frame.c has it. */
    const double bent = CURVED * h * h * (b->k_most * (fabs(b->di.alpha) + fabs(b->di.beta)) + b->push_most);
    double past = 0.0; /* those that may have been at zero, and would be beyond by now */
    double phase[3];
    phases_of((plant_vector_t){b->i.alpha + h * b->di.alpha, b->i.beta + h * b->di.beta}, phase);
    for (int j = 0; j < 3; j++) {
        phase[j] *= side[b->negative][j];
        past += (phase[j] < bent) ? bent - phase[j] : 0.0;
    }
    /* Where another current was at zero, its slope has changed by as much as it would have gone on at most: going through it
     * is slowed down by the drop that changes its sign, or else it stays there. A leg that floats counts as bent. */
    return floats ? past < 1.5 * bent : phase[k] > bent + b->coupling * past;
}

void bridge_begin_again(bridge_t *b)
{
    b->begun = false;
    for (int k = 0; k < 3; k++) {
        if (b->phase[k] == 0.0) {
            set_sign(b, k, 0);
        }
    }
}

void bridge_change(bridge_t *b, const plant_axis_t *config, double r_s)
{
    set_parameters(b, config, r_s);
    b->inverse = inverse_of(b, b->cosine, b->sine);
    flux_follows(b);
    if (b->saturates) {
        tune_iron(b);
    }
    b->begun = false;
}

void bridge_set_magnet(bridge_t *b, double psi_m)
{
    b->psi_m = psi_m;
    flux_follows(b);
    b->begun = false;
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
        bridge_remove_all(b);
    }
}

/* An open phase is beyond the reach of any short. */
static void rewire(bridge_t *b)
{
    const int alone = b->shorted_beside;
    const bool joint = alone >= 0 && !is_open(b, (alone + 1) % 3) && !is_open(b, (alone + 2) % 3);
    b->alone = joint ? alone : -1;
    b->grounded = (b->shorted_leg >= 0 && !is_open(b, b->shorted_leg)) ? b->shorted_leg : -1;
    b->shorted = b->grounded >= 0 || b->alone >= 0;
    b->joint = joint ? BRIDGE_LEGS & ~BRIDGE_LEG(alone) : 0u;
    b->own = BRIDGE_LEGS & ~b->joint & ~((b->grounded >= 0) ? BRIDGE_LEG(b->grounded) : 0u);
    b->positive = b->negative = 0u;
    b->begun = false;
    for (int k = 0; k < 3; k++) { /* those that went together were without a sign of their own */
        set_sign(b, k, (b->phase[k] > 0.0) - (b->phase[k] < 0.0));
    }
}

void bridge_open(bridge_t *b, int k, bool open)
{
    b->reach[k] = open ? FAR : b->v_drop;
    if (open) {
        bridge_remove_phase(b, k);
    }
    rewire(b);
}

void bridge_short(bridge_t *b, int grounded, int alone)
{
    b->shorted_leg = grounded;
    b->shorted_beside = alone;
    rewire(b);
}
