/* averaged_kernel.h - equations of the averaged plant for one number type: NUM is double, or a pair of doubles with one axis in
 * each lane. Both have the same expressions in the same order, so a pair gives the same bits as two single axes.
 *
 * Included with NUM, KERNEL(name), LIMIT(x, low, high) defined.
 */

typedef struct {
    NUM i_d, i_q; /* [A] */
    NUM omega; /* mechanical [rad/s] */
} KERNEL(state_t);

/* Coefficients of the motor's equations, solved for the derivatives and multiplied by half the step h: they give the change in
 * half a step. */
typedef struct {
    NUM angle; /* p h / 2: electrical, of speed */
    NUM inv_l_d, inv_l_q; /* h / (2 L) */
    NUM r_d, r_q; /* R h / (2 L_d), R h / (2 L_q) */
    NUM cross_d, cross_q; /* p L_q h / (2 L_d), p L_d h / (2 L_q) */
    NUM emf; /* p psi_m h / (2 L_q) */
    NUM torque_psi, torque_l; /* 3/2 p psi_m h / (2 J), 3/2 p (L_d - L_q) h / (2 J) */
    NUM viscous; /* B h / (2 J) */
    NUM drag; /* load and friction, whose signs are constant over the step, times h / (2 J) [rad/s] */
} KERNEL(step_t);

typedef struct {
    NUM alpha, beta;
} KERNEL(vector_t);

/* Cosine and sine of an angle of some hundredths [rad], by short series. */
static inline KERNEL(vector_t) KERNEL(small_angle)(NUM x)
{
    const NUM x2 = x * x;
    const KERNEL(vector_t) e = {1.0 - x2 * (0.5 - x2 * ((1.0 / 24.0) - x2 * (1.0 / 720.0))),
                                x * (1.0 - x2 * ((1.0 / 6.0) - x2 * (1.0 / 120.0)))};
    return e;
}

/* Cosine and sine of twice the angle. */
static inline KERNEL(vector_t) KERNEL(double_angle)(KERNEL(vector_t) e)
{
    const NUM twice = e.beta + e.beta;
    const KERNEL(vector_t) result = {1.0 - twice * e.beta, twice * e.alpha};
    return result;
}

/* Cosine and sine of the angle plus a small x, whose cube is below double precision. */
static inline KERNEL(vector_t) KERNEL(add_angle)(KERNEL(vector_t) e, NUM x)
{
    const NUM c = 1.0 - 0.5 * x * x;
    const KERNEL(vector_t) result = {e.alpha * c - e.beta * x, e.beta * c + e.alpha * x};
    return result;
}

/* A constant stator vector in the rotor reference frame after the rotor has rotated by e. */
static inline KERNEL(vector_t) KERNEL(rotate_back)(KERNEL(vector_t) u, KERNEL(vector_t) e)
{
    const KERNEL(vector_t) v = {u.alpha * e.alpha + u.beta * e.beta, u.beta * e.alpha - u.alpha * e.beta};
    return v;
}

/* The same after a further rotation by some millionths [rad]. */
static inline KERNEL(vector_t) KERNEL(rotate_back_further)(KERNEL(vector_t) u, NUM x)
{
    const KERNEL(vector_t) v = {u.alpha + u.beta * x, u.beta - u.alpha * x};
    return v;
}

/* Change in half a step at the derivatives of a state. */
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

/* Runge-Kutta 4 of the rotating motor. `u` is the voltage in the rotor reference frame at the beginning; constant in the stator
 * reference frame, it rotates backwards here. Both stages in the middle use one angle, the mean of theirs. The angles are those
 * of constant speed, corrected by the few millionths that the acceleration adds. *e becomes cosine and sine of the rotation.
 * Returns the mechanical rotation in the step h [rad]. */
static inline NUM KERNEL(runge_kutta)(const KERNEL(step_t) * m, KERNEL(vector_t) u, double h, KERNEL(state_t) * x,
                                      KERNEL(vector_t) * e)
{
    const KERNEL(state_t) x1 = *x;
    const KERNEL(vector_t) e_middle = KERNEL(small_angle)(m->angle * x1.omega);
    const KERNEL(vector_t) e_end = KERNEL(double_angle)(e_middle);
    const KERNEL(vector_t) u_middle = KERNEL(rotate_back)(u, e_middle);
    const KERNEL(vector_t) u_end = KERNEL(rotate_back)(u, e_end);
    const KERNEL(state_t) k1 = KERNEL(change)(m, u, x1);
    const KERNEL(vector_t) u_23 = KERNEL(rotate_back_further)(u_middle, (0.5 * m->angle) * k1.omega);
    const KERNEL(state_t) k2 = KERNEL(change)(m, u_23, KERNEL(sum)(x1, k1));
    const KERNEL(state_t) k3 = KERNEL(change)(m, u_23, KERNEL(sum)(x1, k2));
    const KERNEL(vector_t) u_4 = KERNEL(rotate_back_further)(u_end, (2.0 * m->angle) * k2.omega);
    const KERNEL(state_t) k4 = KERNEL(change)(m, u_4, KERNEL(sum)(x1, KERNEL(sum)(k3, k3)));
    const KERNEL(state_t) k23 = KERNEL(sum)(k2, k3);
    const double third = 1.0 / 3.0;
    x->i_d = x1.i_d + third * ((k1.i_d + 2.0 * k23.i_d) + k4.i_d);
    x->i_q = x1.i_q + third * ((k1.i_q + 2.0 * k23.i_q) + k4.i_q);
    x->omega = x1.omega + third * ((k1.omega + 2.0 * k23.omega) + k4.omega);
    const NUM faster = third * (k1.omega + k23.omega); /* mean speed minus initial speed */
    *e = KERNEL(add_angle)(e_end, (2.0 * m->angle) * faster);
    return h * (x1.omega + faster);
}

/* Phase currents of a current vector in the rotor reference frame. */
static inline void KERNEL(phases)(NUM i_d, NUM i_q, NUM sine, NUM cosine, NUM phase[3])
{
    const NUM alpha = i_d * cosine - i_q * sine;
    const NUM beta = i_d * sine + i_q * cosine;
    phase[0] = alpha;
    phase[1] = -0.5 * alpha + 0.5 * PLANT_SQRT3 * beta;
    phase[2] = -0.5 * alpha - 0.5 * PLANT_SQRT3 * beta;
}

/* One driven leg (averaged_inverter.h): its voltage, and the share of the phase current drawn from the bus. */
static inline NUM KERNEL(drive_leg)(NUM current, NUM inv_i_w, NUM duty, NUM dead, NUM v_drop, double u_dc, NUM *leg)
{
    const NUM x = LIMIT(current * inv_i_w, -1.0, 1.0);
    const NUM s = x * (1.5 - 0.5 * x * x);
    const NUM share = LIMIT(duty - dead * s, 0.0, 1.0);
    *leg = share * u_dc - v_drop * s;
    return share;
}

/* Loss of a driven leg [W], from the means of its current and of its square: power drawn from the bus minus power delivered, which
 * is the loss of the drop, plus that of the on resistance, which is in the motor's circuit. */
static inline NUM KERNEL(leg_loss)(NUM before, NUM after, NUM share, NUM leg, NUM r_on, double u_dc)
{
    const NUM twice = before + after;
    const NUM three_squares = twice * twice - before * after;
    return (share * u_dc - leg) * (0.5 * twice) + r_on * three_squares * (1.0 / 3.0);
}

/* Voltage of a phase against the midpoint of the bus [V]. */
static inline NUM KERNEL(phase_voltage)(NUM leg, NUM current, NUM r_on, double u_dc)
{
    return leg - r_on * current - 0.5 * u_dc;
}
