#include "plant/switched_inverter.h"

#include <string.h>

#include "plant/decay.h"
#include "plant/switched_inverter_general.h"
#include "plant/switched_inverter_interval.h"
#include "plant/switched_inverter_legs.h"

#define CURVATURE_FACTOR 0.75 /* of i'' h^2: 1/2 for the parabola, and half as much again for higher orders */
#define LINEAR_MAX 0.5e-6 /* time in which the currents hardly deviate from their initial slopes [s] */
#define VOLTS_UNLIMITED 1e9 /* voltage that no leg reaches [V] */
#define SATURATED_STEP_MAX 5e-6 /* time in which saturated inductances hardly change [s] */

/* ---- parameters ------------------------------------------------------------------------------------------------------- */

static bool is_open(const switched_inverter_t *inv, int k) { return inv->beyond_rail[k] >= VOLTS_UNLIMITED; }

static void set_drop(switched_inverter_t *inv, double v_drop)
{
    inv->v_drop = v_drop;
    for (int k = 0; k < 3; k++) {
        inv->beyond_rail[k] = is_open(inv, k) ? VOLTS_UNLIMITED : v_drop;
    }
    /* a leg with current out of the motor is two drops above one with current into it */
    for (unsigned legs = 0; legs < INVERTER_LEG_SETS; legs++) {
        for (int lane = 0; lane < INVERTER_LANES; lane++) {
            inv->drops[legs][lane] = 2.0 * v_drop * legs_at[legs][lane];
        }
        inv->drops[legs][LEGS_MEAN] -= v_drop;
    }
}

/* All of the configuration but the initial angle and the amplifiers. */
static void set_parameters(switched_inverter_t *inv, const plant_axis_t *config, double r_s)
{
    set_drop(inv, config->v_drop);
    inv->l_d = config->l_d;
    inv->l_q = config->l_q;
    inv->per_s_d = saturation_of(config->l_d, config->i_saturation_d).per_s;
    inv->per_s_q = saturation_of(config->l_q, config->i_saturation_q).per_s;
    inv->saturates = config->i_saturation_d > 0.0 || config->i_saturation_q > 0.0;
    inverter_set_inductances(inv, config->l_d, config->l_q);
    inv->r_on = config->r_on;
    switched_inverter_set_winding(inv, r_s);
    inv->psi_m = config->psi_m;
    inv->pole_pairs = config->pole_pairs;
    inv->k_torque = 1.5 * config->pole_pairs;
    inv->inv_inertia = 1.0 / config->inertia;
    inv->viscous = config->viscous;
    inv->step_max = 0.1 * ((config->l_d < config->l_q) ? config->l_d : config->l_q) / (config->r_s + config->r_on);
    inv->step_max = (inv->saturates && inv->step_max > SATURATED_STEP_MAX) ? SATURATED_STEP_MAX : inv->step_max;
}

void switched_inverter_init(switched_inverter_t *inverter, const plant_axis_t *config)
{
    *inverter = (switched_inverter_t){
        .friction = config->friction,
        .load = config->load_torque,
        .tau = config->i_settle,
        .theta = config->theta_start,
        .stop_min = -INFINITY,
        .stop_max = INFINITY,
        .trajectory_changed = true,
        .separate = INVERTER_LEGS,
        .requested_grounded = -1,
        .requested_unshorted = -1,
        .grounded = -1,
        .unshorted = -1,
    };
    set_parameters(inverter, config, config->r_s);
    const double x = (config->i_settle > 0.0) ? 1.0 / (INVERTER_CLOCK_HZ * config->i_settle) : 800.0;
    for (int n = 0; n < INVERTER_DECAY; n++) {
        inverter->decay_fine[n] = plant_decay(n * x);
        inverter->decay_coarse[n] = plant_decay(n * INVERTER_DECAY * x);
    }
    inverter_evaluate_angle(inverter);
    inverter->psi.alpha = inverter->psi_m * inverter->cosine;
    inverter->psi.beta = inverter->psi_m * inverter->sine;
}

void switched_inverter_change(switched_inverter_t *inv, const plant_axis_t *config, double r_s)
{
    set_parameters(inv, config, r_s);
    inv->inverse = inverse_of(inv, inv->cosine, inv->sine);
    inverter_update_flux(inv);
    if (inv->saturates) {
        inverter_update_saturated_inductances(inv);
    }
    inv->segment_valid = false;
}

void switched_inverter_set_magnet(switched_inverter_t *inv, double psi_m)
{
    inv->psi_m = psi_m;
    inverter_update_flux(inv);
    inv->segment_valid = false;
}

void switched_inverter_set_winding(switched_inverter_t *inv, double r_s)
{
    inv->r_s = r_s;
    inv->r = r_s + inv->r_on;
}

/* ---- time ------------------------------------------------------------------------------------------------------------- */

void switched_inverter_begin(switched_inverter_t *inv, double u)
{
    if (inv->in_interval || inverter_interval_start(inv, u)) {
        inverter_interval_begin_segment(inv, u);
    } else {
        inverter_general_begin(inv, u);
    }
}

void switched_inverter_restart(switched_inverter_t *inv)
{
    inv->segment_valid = false;
    for (int k = 0; k < 3; k++) {
        if (inv->phase[k] == 0.0) {
            set_sign(inv, k, 0);
        }
    }
}

void switched_inverter_sync(switched_inverter_t *inv)
{
    if (inv->in_interval) {
        inverter_interval_end(inv);
    }
}

double switched_inverter_advance(switched_inverter_t *inv, double h, double u)
{
    double rest = h;
    if (switched_inverter_bus_changed(inv, u)) {
        switched_inverter_sync(inv);
        switched_inverter_restart(inv);
    }
    const double charge = (inv->in_interval || !inv->segment_valid) ? inverter_interval_advance(inv, &rest, u) : 0.0;
    return (rest > INSTANT) ? charge + inverter_general_advance(inv, rest, u) : charge;
}

/* ---- outputs ---------------------------------------------------------------------------------------------------------- */

bool switched_inverter_amplifiers(const switched_inverter_t *inv, double h, double u, double shown[INVERTER_LANES])
{
    if (h <= 0.0) {
        memcpy(shown, inv->amplifier, sizeof inv->amplifier);
        return true;
    }
    if (switched_inverter_bus_changed(inv, u)) {
        return false;
    }
    if (inverter_interval_amplifiers(inv, h, shown)) {
        return true;
    }
    if (h > LINEAR_MAX) {
        return false;
    }
    const double decay = amplifier_decay(inv, h);
    for (int k = 0; k < 3; k++) {
        const double share = shunt_share(inv, k);
        const double slope = dot(inv->di, phase_axis[k]);
        const double begin = share * (inv->phase[k] - inv->tau * slope);
        shown[INVERTER_LANE(k)] = begin + share * h * slope + (inv->amplifier[INVERTER_LANE(k)] - begin) * decay;
    }
    return true;
}

double switched_inverter_shunt(const switched_inverter_t *inv, int k)
{
    return (inv->conduction.lower & INVERTER_LEG(k)) != 0u ? inv->phase[k] : 0.0;
}

terminal_integral_t switched_inverter_integral(const switched_inverter_t *inv)
{
    plant_vector_t psi = inv->psi;
    plant_vector_t charge = inv->charge;
    if (inv->in_interval) {
        psi = inverter_interval_flux(inv);
        charge.alpha += inv->interval.charge.alpha;
        charge.beta += inv->interval.charge.beta;
    }
    /* flux linkage plus the voltage drop of the winding's resistance */
    const double alpha = psi.alpha + inv->r_s * charge.alpha;
    const double beta = HALF_SQRT3 * (psi.beta + inv->r_s * charge.beta);
    const double mean = inv->leg_mean_integral;
    return (terminal_integral_t){{mean + alpha, mean - 0.5 * alpha + beta, mean - 0.5 * alpha - beta}};
}

/* ---- gate edges without effect ---------------------------------------------------------------------------------------- */

/* Without current: true if none begins with other gates; `opens`: they open a leg. */
static bool stays_non_conducting(switched_inverter_t *inv, bool opens, unsigned gates)
{
    if (opens && inv->direction == 0.0) {
        return true; /* its voltage interval grows, and there is no back-EMF */
    }
    const unsigned before = inv->gates;
    int source = 0;
    int sink = 0;
    inv->gates = gates;
    const bool non_conducting =
        inv->unplugged || inverter_blocking_excess(inv, inv->u, inv->psi, inv->omega, &source, &sink) <= 0.0;
    inv->gates = before;
    return non_conducting;
}

/* A floating leg loses its last gate: its voltage interval grows, so it stays floating if it has not left the old interval
 * meanwhile. Its voltage follows the back-EMF, which changes by 3/2 w^2 psi_m at most. */
static bool stays_floating(const switched_inverter_t *inv, int k, double h)
{
    const double w = inv->pole_pairs * inv->omega;
    const double drift = 2.0 * h * w * w * inv->psi_m;
    return inv->floating_volts - drift > leg_min(inv, k, inv->u) &&
           inv->floating_volts + drift < leg_max(inv, k, inv->u);
}

bool switched_inverter_edge_has_no_effect(switched_inverter_t *inv, int k, unsigned gates, double h, double u)
{
    static const double sign[INVERTER_LEG_SETS][3] = {
        [0] = {1, 1, 1},
        [LEG_A] = {-1, 1, 1},
        [LEG_B] = {1, -1, 1},
        [LEG_A | LEG_B] = {-1, -1, 1},
        [LEG_C] = {1, 1, -1},
        [LEG_A | LEG_C] = {-1, 1, -1},
        [LEG_B | LEG_C] = {1, -1, -1},
        [INVERTER_LEGS] = {-1, -1, -1},
    };
    const unsigned leg = INVERTER_LEG(k);
    const bool opens = (gates & INVERTER_BOTH_GATES(leg)) == 0u;
    if (!inv->segment_valid || inv->shorted) {
        return false;
    }
    if (inv->non_conducting) {
        return stays_non_conducting(inv, opens, gates);
    }
    if (inv->saturates) {
        return false; /* the curvature of its currents has no bound here */
    }
    /* the diode across the other switch conducts, whether its gate is on or off */
    if (((inv->gates ^ gates) & (inv->positive | inv->negative << INVERTER_LOWER)) != 0u ||
        switched_inverter_bus_changed(inv, u)) {
        return false;
    }
    const bool floats = ((inv->positive | inv->negative) & leg) == 0u;
    if (floats && (!opens || !stays_floating(inv, k, h))) {
        return false;
    }
    /* Currents by linear extrapolation, and the bound of their curvature: i'' = K i' + e' (switched_inverter_interval.h). */
    const double curved =
        CURVATURE_FACTOR * h * h * (inv->k_max * (fabs(inv->di.alpha) + fabs(inv->di.beta)) + inv->emf_term_max);
    double beyond = 0.0; /* sum over the currents that may have reached zero: how far beyond it they would be */
    double phase[3];
    phases_of((plant_vector_t){inv->i.alpha + h * inv->di.alpha, inv->i.beta + h * inv->di.beta}, phase);
    for (int j = 0; j < 3; j++) {
        phase[j] *= sign[inv->negative][j];
        beyond += (phase[j] < curved) ? curved - phase[j] : 0.0;
    }
    /* After the zero crossing of another current its slope has changed by at most its continuation: the drop that changes its
     * sign slows the current down, or the leg floats. A floating leg counts as curved. */
    return floats ? beyond < 1.5 * curved : phase[k] > curved + inv->coupling * beyond;
}

/* ---- broken wires ----------------------------------------------------------------------------------------------------- */

void switched_inverter_plug(switched_inverter_t *inv, bool plugged)
{
    inv->unplugged = !plugged;
    inv->segment_valid = false;
    if (!plugged) {
        inverter_remove_all_currents(inv);
    }
}

/* A short at an open phase has no effect. */
static void update_shorts(switched_inverter_t *inv)
{
    const int unshorted = inv->requested_unshorted;
    const bool joined = unshorted >= 0 && !is_open(inv, (unshorted + 1) % 3) && !is_open(inv, (unshorted + 2) % 3);
    inv->unshorted = joined ? unshorted : -1;
    inv->grounded =
        (inv->requested_grounded >= 0 && !is_open(inv, inv->requested_grounded)) ? inv->requested_grounded : -1;
    inv->shorted = inv->grounded >= 0 || inv->unshorted >= 0;
    inv->joined = joined ? INVERTER_LEGS & ~INVERTER_LEG(unshorted) : 0u;
    inv->separate = INVERTER_LEGS & ~inv->joined & ~((inv->grounded >= 0) ? INVERTER_LEG(inv->grounded) : 0u);
    inv->positive = inv->negative = 0u;
    inv->segment_valid = false;
    for (int k = 0; k < 3; k++) { /* joined legs had no sign of their own */
        set_sign(inv, k, (inv->phase[k] > 0.0) - (inv->phase[k] < 0.0));
    }
}

void switched_inverter_open(switched_inverter_t *inv, int k, bool open)
{
    inv->beyond_rail[k] = open ? VOLTS_UNLIMITED : inv->v_drop;
    if (open) {
        inverter_remove_phase_current(inv, k);
    }
    update_shorts(inv);
}

void switched_inverter_short(switched_inverter_t *inv, int grounded, int unshorted)
{
    inv->requested_grounded = grounded;
    inv->requested_unshorted = unshorted;
    update_shorts(inv);
}
