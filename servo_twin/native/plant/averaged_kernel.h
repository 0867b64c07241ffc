/* averaged_kernel.h - arithmetic of the averaged plant for one number type: NUM is double, or a pair of doubles that holds
 * one axis in each lane. The same expressions in the same order: a pair computes the same bits as two single axes.
 *
 * Included with NUM, KERNEL(name), LIMIT(x, low, high), SIZE(x) defined.
 */

typedef struct {
    NUM i_d, i_q, omega;
} KERNEL(state_t);

/* Coefficients of the motor's equations, each side divided by what stands before its derivative. */
typedef struct {
    NUM pole_pairs;
    NUM inv_l_d, inv_l_q; /* [1/H] */
    NUM r_d, r_q; /* R / L_d, R / L_q [1/s] */
    NUM cross_d, cross_q; /* p L_q / L_d, p L_d / L_q */
    NUM emf; /* p psi_m / L_q */
    NUM torque_psi, torque_l; /* 3/2 p psi_m / J, 3/2 p (L_d - L_q) / J */
    NUM viscous; /* B / J */
    NUM drag; /* load and friction, which keep their signs over the step, over J [rad/s^2] */
} KERNEL(step_t);

typedef struct {
    NUM alpha, beta;
} KERNEL(vector_t);

/* Cosine and sine of an angle of some hundredths, by short series. */
static inline KERNEL(vector_t) KERNEL(small_angle)(NUM x)
{
    const NUM x2 = x * x;
    const KERNEL(vector_t) e = {1.0 - x2 * (0.5 - x2 * ((1.0 / 24.0) - x2 * (1.0 / 720.0))),
                                x * (1.0 - x2 * ((1.0 / 6.0) - x2 * (1.0 / 120.0)))};
    return e;
}

/* Twice the angle. */
static inline KERNEL(vector_t) KERNEL(doubled)(KERNEL(vector_t) e)
{
    const NUM twice = e.beta + e.beta;
    const KERNEL(vector_t) f = {1.0 - twice * e.beta, twice * e.alpha};
    return f;
}

/* The same angle and a little more: x^3 is beyond double precision. */
static inline KERNEL(vector_t) KERNEL(nudged)(KERNEL(vector_t) e, NUM x)
{
    const NUM c = 1.0 - 0.5 * x * x;
    const KERNEL(vector_t) f = {e.alpha * c - e.beta * x, e.beta * c + e.alpha * x};
    return f;
}

/* A vector that stands still in the stator frame, seen when the rotor has turned by e. */
static inline KERNEL(vector_t) KERNEL(turned_back)(KERNEL(vector_t) u, KERNEL(vector_t) e)
{
    const KERNEL(vector_t) v = {u.alpha * e.alpha + u.beta * e.beta, u.beta * e.alpha - u.alpha * e.beta};
    return v;
}

static inline KERNEL(state_t) KERNEL(derivative)(const KERNEL(step_t) * m, KERNEL(vector_t) u, KERNEL(state_t) x)
{
    const KERNEL(state_t) rate = {
        (u.alpha * m->inv_l_d - m->r_d * x.i_d) + (m->cross_d * x.omega) * x.i_q,
        (u.beta * m->inv_l_q - m->r_q * x.i_q) - x.omega * (m->cross_q * x.i_d + m->emf),
        x.i_q * (m->torque_psi + m->torque_l * x.i_d) - (m->drag + m->viscous * x.omega),
    };
    return rate;
}

static inline KERNEL(state_t) KERNEL(ahead)(KERNEL(state_t) x, KERNEL(state_t) rate, double h)
{
    const KERNEL(state_t) y = {x.i_d + h * rate.i_d, x.i_q + h * rate.i_q, x.omega + h * rate.omega};
    return y;
}

/* Runge-Kutta 4 of the turning motor. `u` is the voltage seen from the rotor at the beginning, d and q: standing still in
 * the stator frame it turns backwards here. Both stages in the middle see it at one angle, the mean of theirs. The angles
 * at constant speed are known beforehand; what the acceleration adds to them is a few millionths. `e` becomes the angle
 * that the rotor has turned by. Returns the way of the shaft. */
static inline NUM KERNEL(runge_kutta)(const KERNEL(step_t) * m, KERNEL(vector_t) u, double h, KERNEL(state_t) * x,
                                      KERNEL(vector_t) * e)
{
    const NUM p_h = m->pole_pairs * h;
    const KERNEL(state_t) x1 = *x;
    const NUM straight = p_h * x1.omega;
    const KERNEL(vector_t) e_middle = KERNEL(small_angle)(0.5 * straight);
    const KERNEL(vector_t) e_end = KERNEL(doubled)(e_middle);
    const KERNEL(state_t) k1 = KERNEL(derivative)(m, u, x1);
    const KERNEL(vector_t) u_middle = KERNEL(turned_back)(u, KERNEL(nudged)(e_middle, p_h * (0.125 * h) * k1.omega));
    const KERNEL(state_t) x2 = KERNEL(ahead)(x1, k1, 0.5 * h);
    const KERNEL(state_t) k2 = KERNEL(derivative)(m, u_middle, x2);
    const KERNEL(vector_t) u_end = KERNEL(turned_back)(u, KERNEL(nudged)(e_end, p_h * (0.5 * h) * k2.omega));
    const KERNEL(state_t) x3 = KERNEL(ahead)(x1, k2, 0.5 * h);
    const KERNEL(state_t) k3 = KERNEL(derivative)(m, u_middle, x3);
    const KERNEL(state_t) x4 = KERNEL(ahead)(x1, k3, h);
    const KERNEL(state_t) k4 = KERNEL(derivative)(m, u_end, x4);
    const double sixth = h * (1.0 / 6.0);
    x->i_d = x1.i_d + sixth * (k1.i_d + 2.0 * (k2.i_d + k3.i_d) + k4.i_d);
    x->i_q = x1.i_q + sixth * (k1.i_q + 2.0 * (k2.i_q + k3.i_q) + k4.i_q);
    x->omega = x1.omega + sixth * (k1.omega + 2.0 * (k2.omega + k3.omega) + k4.omega);
    const NUM more = sixth * (h * (k1.omega + k2.omega + k3.omega)); /* beyond the way at constant speed */
    *e = KERNEL(nudged)(e_end, m->pole_pairs * more);
    return h * x1.omega + more;
}

/* Phase currents of a current vector in the rotor frame. */
static inline void KERNEL(phases)(NUM i_d, NUM i_q, NUM sine, NUM cosine, NUM phase[3])
{
    const NUM alpha = i_d * cosine - i_q * sine;
    const NUM beta = i_d * sine + i_q * cosine;
    phase[0] = alpha;
    phase[1] = -0.5 * alpha + 0.5 * PLANT_SQRT3 * beta;
    phase[2] = -0.5 * alpha - 0.5 * PLANT_SQRT3 * beta;
}

/* One driven leg (inverter.h): part of the phase current that the bus delivers, and the leg's voltage. */
static inline NUM KERNEL(drive_leg)(NUM current, NUM inv_i_w, NUM duty, NUM dead, NUM v_drop, double u_dc, NUM *leg)
{
    const NUM x = LIMIT(current * inv_i_w, -1.0, 1.0);
    const NUM s = x * (1.5 - 0.5 * x * x);
    const NUM share = LIMIT(duty - dead * s, 0.0, 1.0);
    *leg = share * u_dc - v_drop * s;
    return share;
}

/* Power that a phase current burns in the switch or the diode that it goes through. */
static inline NUM KERNEL(leg_power)(NUM current, NUM v_drop, NUM r_on)
{
    const NUM size = SIZE(current);
    return size * (v_drop + r_on * size);
}

/* Voltage of a phase against the midpoint of the bus. */
static inline NUM KERNEL(phase_voltage)(NUM leg, NUM current, NUM r_on, double u_dc)
{
    return leg - r_on * current - 0.5 * u_dc;
}
