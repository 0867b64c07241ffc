/* averaged_kernel.h - arithmetic of the averaged plant for one number type: NUM is double, or a pair of doubles that holds
 * one axis in each lane. The same expressions in the same order: a pair computes the same bits as two single axes.
 *
 * Included with NUM, KERNEL(name), LIMIT(x, low, high) defined.
 */

typedef struct {
    NUM i_d, i_q, omega;
} KERNEL(state_t);

/* Coefficients of the motor's equations, each side divided by what stands before its derivative and times half the step h:
 * what they give is the change in half a step. */
typedef struct {
    NUM angle; /* p h / 2: electrical, of speed */
    NUM inv_l_d, inv_l_q; /* h / (2 L) */
    NUM r_d, r_q; /* R h / (2 L_d), R h / (2 L_q) */
    NUM cross_d, cross_q; /* p L_q h / (2 L_d), p L_d h / (2 L_q) */
    NUM emf; /* p psi_m h / (2 L_q) */
    NUM torque_psi, torque_l; /* 3/2 p psi_m h / (2 J), 3/2 p (L_d - L_q) h / (2 J) */
    NUM viscous; /* B h / (2 J) */
    NUM drag; /* load and friction, which keep their signs over the step, times h / (2 J) [rad/s] */
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

/* The same when it has turned by some millionths more. */
static inline KERNEL(vector_t) KERNEL(nudged_back)(KERNEL(vector_t) u, NUM x)
{
    const KERNEL(vector_t) v = {u.alpha + u.beta * x, u.beta - u.alpha * x};
    return v;
}

/* Change in half a step at the rates of a state. */
static inline KERNEL(state_t) KERNEL(change)(const KERNEL(step_t) * m, KERNEL(vector_t) u, KERNEL(state_t) x)
{
    const KERNEL(state_t) change = {
        (u.alpha * m->inv_l_d - m->r_d * x.i_d) + (m->cross_d * x.omega) * x.i_q,
        (u.beta * m->inv_l_q - m->r_q * x.i_q) - x.omega * (m->cross_q * x.i_d + m->emf),
        x.i_q * (m->torque_psi + m->torque_l * x.i_d) - (m->drag + m->viscous * x.omega),
    };
    return change;
}

static inline KERNEL(state_t) KERNEL(sum)(KERNEL(state_t) x, KERNEL(state_t) y)
{
    const KERNEL(state_t) z = {x.i_d + y.i_d, x.i_q + y.i_q, x.omega + y.omega};
    return z;
}

/* Runge-Kutta 4 of the turning motor. `u` is the voltage seen from the rotor at the beginning, d and q: standing still in
 * the stator frame it turns backwards here. Both stages in the middle see it at one angle, the mean of theirs. The angles
 * at constant speed are known beforehand; what the acceleration adds to them is a few millionths. `e` becomes the angle
 * that the rotor has turned by. Returns the way of the shaft in the step `h`. */
static inline NUM KERNEL(runge_kutta)(const KERNEL(step_t) * m, KERNEL(vector_t) u, double h, KERNEL(state_t) * x,
                                      KERNEL(vector_t) * e)
{
    const KERNEL(state_t) x1 = *x;
    const KERNEL(vector_t) e_middle = KERNEL(small_angle)(m->angle * x1.omega);
    const KERNEL(vector_t) e_end = KERNEL(doubled)(e_middle);
    const KERNEL(vector_t) u_middle = KERNEL(turned_back)(u, e_middle);
    const KERNEL(vector_t) u_end = KERNEL(turned_back)(u, e_end);
    const KERNEL(state_t) k1 = KERNEL(change)(m, u, x1);
    const KERNEL(vector_t) u_23 = KERNEL(nudged_back)(u_middle, (0.5 * m->angle) * k1.omega);
    const KERNEL(state_t) k2 = KERNEL(change)(m, u_23, KERNEL(sum)(x1, k1));
    const KERNEL(state_t) k3 = KERNEL(change)(m, u_23, KERNEL(sum)(x1, k2));
    const KERNEL(vector_t) u_4 = KERNEL(nudged_back)(u_end, (2.0 * m->angle) * k2.omega);
    const KERNEL(state_t) k4 = KERNEL(change)(m, u_4, KERNEL(sum)(x1, KERNEL(sum)(k3, k3)));
    const KERNEL(state_t) k23 = KERNEL(sum)(k2, k3);
    const double third = 1.0 / 3.0;
    x->i_d = x1.i_d + third * ((k1.i_d + 2.0 * k23.i_d) + k4.i_d);
    x->i_q = x1.i_q + third * ((k1.i_q + 2.0 * k23.i_q) + k4.i_q);
    x->omega = x1.omega + third * ((k1.omega + 2.0 * k23.omega) + k4.omega);
    const NUM faster = third * (k1.omega + k23.omega); /* mean speed less that of the beginning */
    *e = KERNEL(nudged)(e_end, (2.0 * m->angle) * faster);
    return h * (x1.omega + faster);
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

/* Power that a driven leg burns, with the means of its current and of the square of it: the difference between what it takes
 * from the bus and what it gives is its drop, and its resistance is in the motor's circuit. */
static inline NUM KERNEL(leg_loss)(NUM before, NUM after, NUM share, NUM leg, NUM r_on, double u_dc)
{
    const NUM twice = before + after;
    const NUM three_squares = twice * twice - before * after;
    return (share * u_dc - leg) * (0.5 * twice) + r_on * three_squares * (1.0 / 3.0);
}

/* Voltage of a phase against the midpoint of the bus. */
static inline NUM KERNEL(phase_voltage)(NUM leg, NUM current, NUM r_on, double u_dc)
{
    return leg - r_on * current - 0.5 * u_dc;
}
