#include "plant/motor.h"

#include <math.h>

#include "plant/trig.h"

/* Slower is standing: otherwise a stop could come after no time at all [rad/s]. */
#define STANDING 1e-9

typedef struct {
    double i_d, i_q, omega;
} state_t;

/* What stays the same over one step. */
typedef struct {
    plant_vector_t u;  /* stator voltage seen from the rotor at the beginning: d and q [V] */
    double drag;       /* load and friction, which keep their signs over the step [N m] */
    double torque_psi; /* 3/2 p psi_m */
    double torque_l;   /* 3/2 p (L_d - L_q) */
} step_t;

/* Angle, sine, cosine and phase currents of the present state. */
static void refresh(plant_motor_t *motor)
{
    plant_sincos(motor->pole_pairs * motor->theta, &motor->sine, &motor->cosine);
    const double alpha = motor->i_d * motor->cosine - motor->i_q * motor->sine;
    const double beta = motor->i_d * motor->sine + motor->i_q * motor->cosine;
    motor->phase[0] = alpha;
    motor->phase[1] = -0.5 * alpha + 0.5 * PLANT_SQRT3 * beta;
    motor->phase[2] = -0.5 * alpha - 0.5 * PLANT_SQRT3 * beta;
}

void plant_motor_init(plant_motor_t *motor, const plant_axis_t *config)
{
    *motor = (plant_motor_t){
        .r = config->r_s + config->r_on,
        .l_d = config->l_d,
        .l_q = config->l_q,
        .inv_l_d = 1.0 / config->l_d,
        .inv_l_q = 1.0 / config->l_q,
        .psi_m = config->psi_m,
        .pole_pairs = config->pole_pairs,
        .inv_inertia = 1.0 / config->inertia,
        .friction = config->friction,
        .viscous = config->viscous,
        .theta = config->theta_start,
        .low = -INFINITY,
        .high = INFINITY,
    };
    refresh(motor);
}

/* A voltage that stands still in the stator frame turns backwards in the rotor frame: `u` when the rotor has turned by
 * `delta` (electrical), a few hundredths at most, so that short series do. */
static inline plant_vector_t turned(plant_vector_t u, double delta)
{
    const double d2 = delta * delta;
    const double c = 1.0 - d2 * (0.5 - d2 * (1.0 / 24.0));
    const double s = delta * (1.0 - d2 * ((1.0 / 6.0) - d2 * (1.0 / 120.0)));
    const plant_vector_t v = {u.alpha * c + u.beta * s, u.beta * c - u.alpha * s};
    return v;
}

static inline state_t derivative(const plant_motor_t *m, const step_t *step, plant_vector_t u, state_t x)
{
    const double omega_e = m->pole_pairs * x.omega;
    const double torque = x.i_q * (step->torque_psi + step->torque_l * x.i_d);
    const state_t rate = {
        (u.alpha - m->r * x.i_d + omega_e * m->l_q * x.i_q) * m->inv_l_d,
        (u.beta - m->r * x.i_q - omega_e * (m->l_d * x.i_d + m->psi_m)) * m->inv_l_q,
        (torque - step->drag - m->viscous * x.omega) * m->inv_inertia,
    };
    return rate;
}

static inline state_t ahead(state_t x, state_t rate, double h)
{
    const state_t y = {x.i_d + h * rate.i_d, x.i_q + h * rate.i_q, x.omega + h * rate.omega};
    return y;
}

static step_t begin(const plant_motor_t *m, plant_vector_t u, double direction)
{
    const double k = 1.5 * m->pole_pairs;
    const step_t step = {
        .u = {u.alpha * m->cosine + u.beta * m->sine, u.beta * m->cosine - u.alpha * m->sine},
        .drag = m->load + direction * m->friction,
        .torque_psi = k * m->psi_m,
        .torque_l = k * (m->l_d - m->l_q),
    };
    return step;
}

/* Runge-Kutta 4 of the turning motor, friction against `direction`. Both stages in the middle see the voltage at one
 * angle, the mean of theirs. */
static void turn(plant_motor_t *m, plant_vector_t u, double h, double direction)
{
    const step_t step = begin(m, u, direction);
    const double p_h = m->pole_pairs * h;
    const state_t x1 = {m->i_d, m->i_q, m->omega};
    const state_t k1 = derivative(m, &step, step.u, x1);
    const plant_vector_t u_middle = turned(step.u, p_h * (0.5 * x1.omega + 0.125 * h * k1.omega));
    const state_t x2 = ahead(x1, k1, 0.5 * h);
    const state_t k2 = derivative(m, &step, u_middle, x2);
    const plant_vector_t u_end = turned(step.u, p_h * (x1.omega + 0.5 * h * k2.omega));
    const state_t x3 = ahead(x1, k2, 0.5 * h);
    const state_t k3 = derivative(m, &step, u_middle, x3);
    const state_t x4 = ahead(x1, k3, h);
    const state_t k4 = derivative(m, &step, u_end, x4);
    const double sixth = h * (1.0 / 6.0);
    m->i_d = x1.i_d + sixth * (k1.i_d + 2.0 * (k2.i_d + k3.i_d) + k4.i_d);
    m->i_q = x1.i_q + sixth * (k1.i_q + 2.0 * (k2.i_q + k3.i_q) + k4.i_q);
    m->omega = x1.omega + sixth * (k1.omega + 2.0 * (k2.omega + k3.omega) + k4.omega);
    m->theta += sixth * (x1.omega + 2.0 * (x2.omega + x3.omega) + x4.omega);
}

/* The shaft stands: two separate R-L circuits, whose Runge-Kutta 4 step is a polynomial in h R / L. */
static double relax(double i, double i_end, double x)
{
    return i_end + (i - i_end) * (1.0 - x * (1.0 - x * (0.5 - x * ((1.0 / 6.0) - x * (1.0 / 24.0)))));
}

static void stand(plant_motor_t *m, plant_vector_t u, double h)
{
    const step_t step = begin(m, u, 0.0);
    m->i_d = relax(m->i_d, step.u.alpha / m->r, h * m->r * m->inv_l_d);
    m->i_q = relax(m->i_q, step.u.beta / m->r, h * m->r * m->inv_l_q);
}

/* Open windings: the shaft alone, exact to second order in h B / J. */
static void coast(plant_motor_t *m, double h, double direction)
{
    const double start = m->omega;
    const double rate = -(m->load + direction * m->friction + m->viscous * start) * m->inv_inertia;
    m->omega = start + h * rate * (1.0 - 0.5 * h * m->viscous * m->inv_inertia);
    m->theta += 0.5 * h * (start + m->omega);
}

/* Direction of motion during the next step; 0 when the shaft stays where it is. */
static double direction_of(plant_motor_t *m, double torque)
{
    if (m->locked) {
        return 0.0;
    }
    if (m->omega > STANDING) {
        return 1.0;
    }
    if (m->omega < -STANDING) {
        return -1.0;
    }
    m->omega = 0.0;
    const double drive = torque - m->load;
    if (drive > m->friction) {
        return (m->theta < m->high) ? 1.0 : 0.0;
    }
    return (drive < -m->friction && m->theta > m->low) ? -1.0 : 0.0;
}

/* What the shaft meets at an end stop takes its speed; within a step, where exactly does not matter. */
static void stop(plant_motor_t *m)
{
    if (m->theta < m->low || m->theta > m->high) {
        m->theta = (m->theta < m->low) ? m->low : m->high;
        m->omega = 0.0;
    }
}

/* The shaft stopped within `dt`, having begun with `before`: go to that moment, found by false position. */
static double turn_until_stop(plant_motor_t *m, plant_vector_t u, double dt, double direction, state_t before,
                              double theta)
{
    double early = 0.0;
    double late = dt;
    double omega_early = before.omega;
    double omega_late = m->omega;
    double used = dt;
    for (int i = 0; i < 3; i++) {
        used = early + (late - early) * (omega_early / (omega_early - omega_late));
        m->i_d = before.i_d;
        m->i_q = before.i_q;
        m->omega = before.omega;
        m->theta = theta;
        turn(m, u, used, direction);
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
    const double direction = direction_of(motor, plant_motor_torque(motor));
    double used = dt;
    if (direction == 0.0) {
        stand(motor, u, dt);
    } else {
        const state_t before = {motor->i_d, motor->i_q, motor->omega};
        const double theta = motor->theta;
        turn(motor, u, dt, direction);
        if (motor->omega * direction < 0.0) {
            if (before.omega != 0.0) {
                used = turn_until_stop(motor, u, dt, direction, before, theta);
            } else { /* the torque that broke it loose is gone within the step: it never left */
                motor->i_d = before.i_d;
                motor->i_q = before.i_q;
                motor->omega = 0.0;
                motor->theta = theta;
                stand(motor, u, dt);
            }
        }
        stop(motor);
    }
    refresh(motor);
    return used;
}

double plant_motor_coast(plant_motor_t *motor, double dt)
{
    const double direction = direction_of(motor, 0.0);
    if (direction == 0.0) {
        return dt;
    }
    const double omega = motor->omega;
    const double theta = motor->theta;
    double used = dt;
    coast(motor, dt, direction);
    if (motor->omega * direction < 0.0) {
        used = dt * (omega / (omega - motor->omega));
        motor->omega = 0.0;
        motor->theta = theta + 0.5 * used * omega;
    }
    stop(motor);
    refresh(motor);
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
}

void plant_motor_lock(plant_motor_t *motor, bool locked)
{
    motor->locked = locked;
    if (locked) {
        motor->omega = 0.0;
    }
}

void plant_motor_obstruct(plant_motor_t *motor, double below, double above)
{
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
