#include "plant/switched_inverter_general.h"

#include "plant/switched_inverter_step.h"

#define SEGMENT_PARTS_MAX 24 /* parts of one segment that end at an event; its rest is one step */
#define STANDSTILL 1e-9 /* lower speeds count as standstill [rad/s] */
#define FRICTION_MARGIN 1e-9 /* the shaft starts at a growing torque this close to the friction, relatively */

/* ---- begin a segment -------------------------------------------------------------------------------------------------- */

/* di/dt at the beginning of a segment in which the flux changes by dpsi/dt: i' = L^-1 (psi' - j w psi) + j w i, from
 * d/dt of e^{j theta} L^-1 (e^{-j theta} psi - psi_m). */
static plant_vector_t current_slope(const switched_inverter_t *inv, plant_vector_t dpsi)
{
    const double w = inv->pole_pairs * inv->omega;
    const plant_vector_t drive = {dpsi.alpha + w * inv->psi.beta, dpsi.beta - w * inv->psi.alpha};
    const plant_vector_t rate = times(inv->inverse, drive);
    return (plant_vector_t){rate.alpha - w * inv->i.beta, rate.beta + w * inv->i.alpha};
}

/* A torque that will exceed the friction within INSTANT counts as doing so. */
static bool starts(const switched_inverter_t *inv, double direction)
{
    const double excess = (inv->torque - inv->load) * direction - inv->friction;
    const double grows = inv->dtorque * direction;
    const bool exceeds =
        excess > 0.0 || (grows > 0.0 && excess > -FRICTION_MARGIN * inv->friction - 2.0 * INSTANT * grows);
    return exceeds && direction_is_free(inv, direction);
}

/* Direction of motion from standstill. */
static double direction_from_standstill(const switched_inverter_t *inv)
{
    if (inv->locked || inv->held_at_stop) {
        return 0.0;
    }
    const double direction = (inv->torque > inv->load) ? 1.0 : -1.0;
    if (starts(inv, direction)) {
        return direction;
    }
    return starts(inv, -direction) ? -direction : 0.0; /* without friction, away from an end stop */
}

void inverter_general_begin(switched_inverter_t *inv, double u)
{
    inv->floating = -1;
    inv->non_conducting = false;
    inv->segment_valid = inv->trajectory_changed = true;
    inv->u = u;
    update_curvature_bounds(inv);
    int k = leg_at_zero(inv);
    if (k == ALL_LEGS_ZERO) {
        k = inverter_find_conducting_pair(inv, u);
    }
    update_conduction(inv);
    if (inv->non_conducting) {
        inv->switch_vector = inv->drop_vector = inv->di = (plant_vector_t){0.0, 0.0};
        inv->dtorque = 0.0;
    } else {
        plant_vector_t dpsi = {u * inv->switch_vector.alpha + inv->drop_vector.alpha - inv->r * inv->i.alpha,
                               u * inv->switch_vector.beta + inv->drop_vector.beta - inv->r * inv->i.beta};
        inv->di = current_slope(inv, dpsi);
        if (k >= 0) {
            const plant_vector_t per_n = times(inv->inverse, phase_axis[k]);
            const double needed = -1.5 * dot(phase_axis[k], inv->di) / dot(phase_axis[k], per_n);
            const double lift = settle_leg(inv, k, leg_min(inv, k, u), leg_max(inv, k, u), needed);
            const double size = (2.0 / 3.0) * lift;
            const plant_vector_t volts = {size * phase_axis[k].alpha, size * phase_axis[k].beta};
            inv->di.alpha += size * per_n.alpha;
            inv->di.beta += size * per_n.beta;
            dpsi.alpha += volts.alpha;
            dpsi.beta += volts.beta;
            update_conduction(inv);
            if (inv->floating >= 0) {
                inv->drop_vector.alpha += volts.alpha;
                inv->drop_vector.beta += volts.beta;
                inv->leg_mean += THIRD * lift;
            }
        }
        inv->dtorque = inv->k_torque * (cross(dpsi, inv->i) + cross(inv->psi, inv->di));
    }
    if (inv->omega > STANDSTILL) {
        inv->direction = 1.0;
    } else if (inv->omega < -STANDSTILL) {
        inv->direction = -1.0;
    } else {
        inv->omega = 0.0;
        inv->direction = direction_from_standstill(inv);
        if (inv->direction == 0.0) {
            inv->accel = 0.0;
            inv->jerk = 0.0;
            return;
        }
    }
    inv->accel =
        (inv->torque - inv->load - inv->direction * inv->friction - inv->viscous * inv->omega) * inv->inv_inertia;
    inv->jerk = inv->dtorque * inv->inv_inertia;
}

/* ---- advance ---------------------------------------------------------------------------------------------------------- */

/* First-order lag behind a straight line, exact. */
static double lag_behind(double y, double from, double to, double tau_h, double decay)
{
    const double lag = tau_h * (to - from);
    return to - lag + (y - from + lag) * decay;
}

/* Outputs of the amplifiers after h seconds, behind currents that change linearly to `phase`. */
static void filter_currents(switched_inverter_t *inv, double h, const double phase[3])
{
    const double decay = amplifier_decay(inv, h);
    const double tau_h = inv->tau / h;
    for (int k = 0; k < 3; k++) {
        const double share = shunt_share(inv, k);
        double *shown = &inv->amplifier[INVERTER_LANE(k)];
        *shown = lag_behind(*shown, share * inv->phase[k], share * phase[k], tau_h, decay);
    }
}

/* Take over the end of a step of length h > 0; `u_h` is the integral of the bus voltage [V s]. Returns the charge drawn. */
static double accept_step(switched_inverter_t *inv, double h, double u_h, const step_end_t *e)
{
    const double charge = 1.5 * dot(inv->switch_vector, e->charge);
    const double squares = (0.5 * h) * (dot(inv->i, inv->i) + dot(inv->i, e->i) + dot(e->i, e->i)); /* 3/2 int i^2 */
    filter_currents(inv, h, e->phase);
    inv->e_copper += inv->r_s * squares;
    inv->e_switch += inv->r_on * squares - 1.5 * dot(inv->drop_vector, e->charge);
    inv->e_bus += charge * u_h / h;
    inv->charge.alpha += e->charge.alpha;
    inv->charge.beta += e->charge.beta;
    inv->leg_mean_integral += inv->leg_mean * h;
    inv->impulse += (THIRD * h) * (2.0 * inv->torque + (0.5 * h) * inv->dtorque + e->torque);
    inv->psi = e->psi;
    inv->i = e->i;
    inv->theta = e->theta;
    inv->omega = e->omega;
    inv->cosine = e->cosine;
    inv->sine = e->sine;
    inv->inverse = e->inverse;
    inv->torque = e->torque;
    inv->phase[0] = e->phase[0];
    inv->phase[1] = e->phase[1];
    inv->phase[2] = e->phase[2];
    inv->segment_valid = false;
    if (inv->saturates) {
        inverter_update_saturated_inductances(inv);
    }
    inverter_count_rotation(inv);
    return charge;
}

/* Change of state at the event that has ended a step. */
static void apply_event(switched_inverter_t *inv, const step_limit_t *limit)
{
    switch (limit->reason) {
    case STEP_CURRENT_ZERO:
        set_sign(inv, limit->phase, 0);
        if (inv->floating >= 0) {
            inverter_remove_all_currents(inv);
        } else {
            inverter_remove_phase_current(inv, limit->phase);
        }
        break;
    case STEP_LEG_LIMIT:
        if (limit->phase >= 0) {
            set_sign(inv, limit->phase, limit->sign);
        }
        break;
    case STEP_SHAFT_STOPPED:
        inv->held_at_stop = limit->duration <= 0.0; /* no motion has begun */
        inv->omega = 0.0;
        break;
    case STEP_END_STOP:
        inv->held_at_stop = limit->duration <= 0.0;
        inv->theta = (limit->sign > 0) ? inv->stop_max : inv->stop_min; /* corrects the error of the root */
        inv->omega = 0.0;
        inverter_evaluate_angle(inv);
        inverter_update_flux(inv);
        break;
    case STEP_SHAFT_STARTED:
    case STEP_COMPLETE:
        break;
    }
}

double inverter_general_advance(switched_inverter_t *inv, double h, double u)
{
    double charge = 0.0;
    double rest = h;
    const int parts_max = SEGMENT_PARTS_MAX * (1 + (int)(h / inv->step_max));
    for (int n = 0; rest > INSTANT; n++) {
        step_end_t e;
        double floating_volts;
        const double part = (rest < inv->step_max) ? rest : inv->step_max;
        step_limit_t limit = {part, STEP_COMPLETE, 0, 0};
        if (!inv->segment_valid) {
            inverter_general_begin(inv, u);
        }
        if (n < parts_max) {
            limit = inverter_general_step_to_event(inv, part, u, &e);
        } else {
            inverter_general_step(inv, part, u, &e, &floating_volts);
            if (e.theta > inv->stop_max || e.theta < inv->stop_min) {
                limit = (step_limit_t){part, STEP_END_STOP, 0, (e.theta > inv->stop_max) ? 1 : -1};
            }
        }
        if (limit.duration > 0.0) {
            charge += accept_step(inv, limit.duration, u * limit.duration, &e);
        }
        inv->segment_valid = false;
        apply_event(inv, &limit);
        rest -= limit.duration;
    }
    inv->held_at_stop = false;
    return charge;
}
