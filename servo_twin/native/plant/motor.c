#include "plant/motor.h"

#include <math.h>

#include "plant/inline.h"
#include "plant/trig.h"

#define NUM double
#define KERNEL(name) single_##name
#define LIMIT(x, low, high) plant_limit(x, low, high)
#include "plant/averaged_kernel.h"

void plant_motor_refresh_exact(plant_motor_t *motor)
{
    motor->steps = 0;
    plant_sincos(motor->pole_pairs * motor->theta, &motor->sine, &motor->cosine);
    single_phases(motor->i_d, motor->i_q, motor->sine, motor->cosine, motor->phase);
}

/* Phase currents of the state after a step. Sine and cosine were rotated by the step and are evaluated from the angle
 * only now and then. */
static void refresh_phases(plant_motor_t *motor)
{
    single_phases(motor->i_d, motor->i_q, motor->sine, motor->cosine, motor->phase);
    plant_motor_count_step(motor);
}

/* Inductances at the present currents, whose fluxes these are [V s]. */
static void set_inductances(plant_motor_t *m, double flux_d, double flux_q)
{
    m->l_d = (m->i_d != 0.0) ? flux_d / m->i_d : m->iron_d.l;
    m->l_q = (m->i_q != 0.0) ? flux_q / m->i_q : m->iron_q.l;
    m->inv_l_d = 1.0 / saturation_inductance(m->iron_d, flux_d);
    m->inv_l_q = 1.0 / saturation_inductance(m->iron_q, flux_q);
    m->torque_l = 1.5 * m->pole_pairs * (m->l_d - m->l_q);
}

static void update_saturation(plant_motor_t *m)
{
    if (m->saturates) {
        set_inductances(m, saturation_flux(m->iron_d, m->i_d), saturation_flux(m->iron_q, m->i_q));
    }
}

void plant_motor_change(plant_motor_t *motor, const plant_axis_t *config)
{
    motor->r = config->r_s + config->r_on;
    motor->inv_r = 1.0 / motor->r;
    motor->l_d = config->l_d;
    motor->l_q = config->l_q;
    motor->inv_l_d = 1.0 / config->l_d;
    motor->inv_l_q = 1.0 / config->l_q;
    motor->psi_m = config->psi_m;
    motor->pole_pairs = config->pole_pairs;
    motor->inv_inertia = 1.0 / config->inertia;
    motor->viscous = config->viscous;
    motor->torque_psi = 1.5 * config->pole_pairs * config->psi_m;
    motor->torque_l = 1.5 * config->pole_pairs * (config->l_d - config->l_q);
    motor->iron_d = saturation_of(config->l_d, config->i_saturation_d);
    motor->iron_q = saturation_of(config->l_q, config->i_saturation_q);
    motor->saturates = config->i_saturation_d > 0.0 || config->i_saturation_q > 0.0;
    update_saturation(motor);
}

void plant_motor_warm(plant_motor_t *motor, double r_s, double r_on, double psi_m)
{
    motor->r = r_s + r_on;
    motor->inv_r = 1.0 / motor->r;
    motor->psi_m = psi_m;
    motor->torque_psi = 1.5 * motor->pole_pairs * psi_m;
}

void plant_motor_init(plant_motor_t *motor, const plant_axis_t *config)
{
    *motor = (plant_motor_t){
        .friction = config->friction,
        .load = config->load_torque,
        .theta = config->theta_start,
        .low = -INFINITY,
        .high = INFINITY,
    };
    plant_motor_change(motor, config);
    plant_motor_refresh_exact(motor);
}

/* Stator voltage in the rotor reference frame. */
static single_vector_t to_rotor(const plant_motor_t *m, plant_vector_t u)
{
    const single_vector_t v = {u.alpha * m->cosine + u.beta * m->sine, u.beta * m->cosine - u.alpha * m->sine};
    return v;
}

/* State of a motor with saturated iron, or its derivatives: flux of the currents [V s], speed [rad/s], rotation since the
 * beginning of the step [rad]. */
typedef struct {
    double flux_d, flux_q, omega, rotation;
} saturated_state_t;

static saturated_state_t saturated_sum(saturated_state_t x, double h, saturated_state_t rate)
{
    return (saturated_state_t){x.flux_d + h * rate.flux_d, x.flux_q + h * rate.flux_q, x.omega + h * rate.omega,
                               x.rotation + h * rate.rotation};
}

/* Derivatives at the voltage u in the rotor reference frame at the beginning. */
static saturated_state_t saturated_rate(const plant_motor_t *m, single_vector_t u, double direction,
                                        saturated_state_t x)
{
    const single_vector_t v = single_rotate_back(u, single_small_angle(m->pole_pairs * x.rotation));
    const double i_d = saturation_current(m->iron_d, x.flux_d);
    const double i_q = saturation_current(m->iron_q, x.flux_q);
    const double w = m->pole_pairs * x.omega;
    const double psi_d = m->psi_m + x.flux_d;
    const double torque = 1.5 * m->pole_pairs * (psi_d * i_q - x.flux_q * i_d);
    const double drag = m->load + direction * m->friction + m->viscous * x.omega;
    return (saturated_state_t){v.alpha - m->r * i_d + w * x.flux_q, v.beta - m->r * i_q - w * psi_d,
                               direction * direction * (torque - drag) * m->inv_inertia, x.omega};
}

/* Runge-Kutta step of the fluxes; `direction` 0: standstill. */
static PLANT_COLD void step_saturated(plant_motor_t *m, plant_vector_t u, double h, double direction)
{
    const single_vector_t v = to_rotor(m, u);
    const saturated_state_t x = {saturation_flux(m->iron_d, m->i_d), saturation_flux(m->iron_q, m->i_q),
                                 (direction != 0.0) ? m->omega : 0.0, 0.0};
    const saturated_state_t k1 = saturated_rate(m, v, direction, x);
    const saturated_state_t k2 = saturated_rate(m, v, direction, saturated_sum(x, 0.5 * h, k1));
    const saturated_state_t k3 = saturated_rate(m, v, direction, saturated_sum(x, 0.5 * h, k2));
    const saturated_state_t k4 = saturated_rate(m, v, direction, saturated_sum(x, h, k3));
    const saturated_state_t middle = saturated_sum(k2, 1.0, k3);
    const saturated_state_t mean = saturated_sum(saturated_sum(k1, 1.0, k4), 2.0, middle);
    const saturated_state_t end = saturated_sum(x, h * (1.0 / 6.0), mean);
    const single_vector_t e = single_small_angle(m->pole_pairs * end.rotation);
    const double cosine = m->cosine;
    m->cosine = cosine * e.alpha - m->sine * e.beta;
    m->sine = m->sine * e.alpha + cosine * e.beta;
    m->theta += end.rotation;
    m->omega = end.omega;
    m->i_d = saturation_current(m->iron_d, end.flux_d);
    m->i_q = saturation_current(m->iron_q, end.flux_q);
    set_inductances(m, end.flux_d, end.flux_q);
}

/* Runge-Kutta step of the rotating motor; friction acts against `direction`. */
static void step_rotating(plant_motor_t *m, plant_vector_t u, double h, double direction)
{
    if (m->saturates) {
        step_saturated(m, u, h, direction);
        return;
    }
    const double per_l_d = 0.5 * h * m->inv_l_d;
    const double per_l_q = 0.5 * h * m->inv_l_q;
    const double per_j = 0.5 * h * m->inv_inertia;
    const single_step_t step = {
        .angle = 0.5 * h * m->pole_pairs,
        .inv_l_d = per_l_d,
        .inv_l_q = per_l_q,
        .r_d = m->r * per_l_d,
        .r_q = m->r * per_l_q,
        .cross_d = m->pole_pairs * m->l_q * per_l_d,
        .cross_q = m->pole_pairs * m->l_d * per_l_q,
        .emf = m->pole_pairs * m->psi_m * per_l_q,
        .torque_psi = m->torque_psi * per_j,
        .torque_l = m->torque_l * per_j,
        .viscous = m->viscous * per_j,
        .drag = (m->load + direction * m->friction) * per_j,
    };
    single_state_t x = {m->i_d, m->i_q, m->omega};
    single_vector_t e;
    m->theta += single_runge_kutta(&step, to_rotor(m, u), h, &x, &e);
    m->i_d = x.i_d;
    m->i_q = x.i_q;
    m->omega = x.omega;
    const double cosine = m->cosine;
    m->cosine = cosine * e.alpha - m->sine * e.beta;
    m->sine = m->sine * e.alpha + cosine * e.beta;
}

/* At standstill d and q are separate R-L circuits, whose Runge-Kutta 4 step is a polynomial in h R / L. */
static double relax(double i, double i_end, double x)
{
    return i_end + (i - i_end) * (1.0 - x * (1.0 - x * (0.5 - x * ((1.0 / 6.0) - x * (1.0 / 24.0)))));
}

static void step_standing(plant_motor_t *m, plant_vector_t u, double h)
{
    if (m->saturates) {
        step_saturated(m, u, h, 0.0);
        return;
    }
    const single_vector_t v = to_rotor(m, u);
    m->i_d = relax(m->i_d, v.alpha * m->inv_r, h * m->r * m->inv_l_d);
    m->i_q = relax(m->i_q, v.beta * m->inv_r, h * m->r * m->inv_l_q);
}

/* The shaft without current, exact to second order in h B / J. */
static void step_coasting(plant_motor_t *m, double h, double direction)
{
    const double start = m->omega;
    const double rate = -(m->load + direction * m->friction + m->viscous * start) * m->inv_inertia;
    m->omega = start + h * rate * (1.0 - 0.5 * h * m->viscous * m->inv_inertia);
    m->theta += 0.5 * h * (start + m->omega);
}

/* Direction of motion during the next step; 0: standstill. A speed within the standstill range is set to 0. */
static double start_direction(plant_motor_t *m, double torque)
{
    if (m->locked) {
        return 0.0;
    }
    if (m->omega > PLANT_STANDING) {
        return 1.0;
    }
    if (m->omega < -PLANT_STANDING) {
        return -1.0;
    }
    m->omega = 0.0;
    const double drive = torque - m->load;
    if (drive > m->friction) {
        return (m->theta < m->high) ? 1.0 : 0.0;
    }
    return (drive < -m->friction && m->theta > m->low) ? -1.0 : 0.0;
}

/* refresh_phases evaluates sine and cosine at the end of this step. */
static void request_trig(plant_motor_t *m) { m->steps = PLANT_FRESH_TRIG; }

/* An inelastic end stop stops the shaft; the exact instant within the step is neglected. */
static void apply_end_stops(plant_motor_t *m)
{
    if (m->theta < m->low || m->theta > m->high) {
        m->theta = (m->theta < m->low) ? m->low : m->high;
        m->omega = 0.0;
        request_trig(m);
    }
}

/* The shaft stops within `dt` after the state `before`: step to that instant, found by regula falsi. */
static double step_until_stop(plant_motor_t *m, plant_vector_t u, double dt, double direction,
                              const plant_motor_t *before)
{
    double early = 0.0;
    double late = dt;
    double omega_early = before->omega;
    double omega_late = m->omega;
    double used = dt;
    for (int i = 0; i < 3; i++) {
        used = early + (late - early) * (omega_early / (omega_early - omega_late));
        *m = *before;
        step_rotating(m, u, used, direction);
        if (m->omega * direction < 0.0) {
            late = used;
            omega_late = m->omega;
        } else {
            early = used;
            omega_early = m->omega;
        }
    }
    m->omega = 0.0;
    return used;
}

double plant_motor_step(plant_motor_t *motor, plant_vector_t u, double dt)
{
    const double direction = start_direction(motor, plant_motor_torque(motor));
    if (direction == 0.0) {
        step_standing(motor, u, dt);
        refresh_phases(motor);
        return dt;
    }
    const plant_motor_t before = *motor;
    double used = dt;
    step_rotating(motor, u, dt, direction);
    if (motor->omega * direction < 0.0) {
        if (before.omega != 0.0) {
            used = step_until_stop(motor, u, dt, direction, &before);
        } else { /* the torque that exceeded friction vanishes within the step: no motion */
            *motor = before;
            motor->omega = 0.0;
            step_standing(motor, u, dt);
        }
    }
    apply_end_stops(motor);
    refresh_phases(motor);
    return used;
}

double plant_motor_coast(plant_motor_t *motor, double dt)
{
    const double direction = start_direction(motor, 0.0);
    if (direction == 0.0) {
        return dt;
    }
    const double omega = motor->omega;
    const double theta = motor->theta;
    double used = dt;
    step_coasting(motor, dt, direction);
    if (motor->omega * direction < 0.0) {
        used = dt * (omega / (omega - motor->omega));
        motor->omega = 0.0;
        motor->theta = theta + 0.5 * used * omega;
    }
    apply_end_stops(motor);
    request_trig(motor);
    refresh_phases(motor);
    return used;
}

void plant_motor_set_phases(plant_motor_t *motor, double i_a, double i_b)
{
    const double abc[3] = {i_a, i_b, -i_a - i_b};
    const plant_vector_t i = plant_clarke(abc);
    motor->i_d = i.alpha * motor->cosine + i.beta * motor->sine;
    motor->i_q = i.beta * motor->cosine - i.alpha * motor->sine;
    motor->phase[0] = abc[0];
    motor->phase[1] = abc[1];
    motor->phase[2] = abc[2];
    update_saturation(motor);
}

void plant_motor_lock(plant_motor_t *motor, bool locked)
{
    motor->locked = locked;
    if (locked) {
        motor->omega = 0.0;
    }
}

void plant_motor_set_fine(plant_motor_t *motor, bool fine)
{
    motor->fine = fine;
    motor->single = fine || motor->obstructed;
}

void plant_motor_obstruct(plant_motor_t *motor, double below, double above)
{
    motor->obstructed = isfinite(below) || isfinite(above);
    plant_motor_set_fine(motor, motor->fine);
    motor->low = motor->theta - below;
    motor->high = motor->theta + above;
}

double plant_motor_torque(const plant_motor_t *motor)
{
    const double psi_d = motor->psi_m + motor->l_d * motor->i_d;
    const double psi_q = motor->l_q * motor->i_q;
    return 1.5 * motor->pole_pairs * (psi_d * motor->i_q - psi_q * motor->i_d);
}

void plant_motor_back_emf(const plant_motor_t *motor, double emf[3])
{
    const double e = motor->pole_pairs * motor->omega * motor->psi_m;
    const double alpha = -e * motor->sine;
    const double beta = e * motor->cosine;
    emf[0] = alpha;
    emf[1] = -0.5 * alpha + 0.5 * PLANT_SQRT3 * beta;
    emf[2] = -0.5 * alpha - 0.5 * PLANT_SQRT3 * beta;
}
