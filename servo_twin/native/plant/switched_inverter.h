/* switched_inverter.h - three-phase inverter with its motor at switching level, between two gate edges.
 *
 * Legs. The voltage of a leg depends on its gates and on the sign of its current i (positive into the motor). u is the bus
 * voltage, V the forward drop of a switch or diode. Their on resistance is in series with the phase, so it is part of the
 * motor's circuit:
 *
 *   gates            i > 0           i < 0           i = 0
 *   upper on         u - V (switch)  u + V (diode)   any voltage between the two
 *   lower on          -V  (diode)      V  (switch)    ''
 *   both off          -V  (diode)    u + V (diode)    ''
 *
 * A leg is therefore a voltage interval. At the lower limit its current is positive, at the upper limit negative. A leg
 * without current floats: it takes the voltage inside the interval that keeps its current at zero, while there is one.
 *
 * Motor, in the stator reference frame (DRM E11-E15 with separate L_d and L_q, amplitude-invariant vectors):
 *   d(psi)/dt = v - R i,    i = e^{j theta_e} L^-1 (e^{-j theta_e} psi - psi_m)
 *   T_e = 3/2 p psi x i,    J d(omega)/dt = T_e - T_load - B omega - T_friction
 * A segment is a time in which no gate changes and, outside of a linear interval, no current changes its sign. The voltage of
 * the legs is then v = u a + b with constant vectors a, b, and its integral enters psi without error. Only R i is integrated
 * numerically, by a quadrature that is exact for a current of second order,
 *   Q = h (2 i_0 + i_1) / 3 + h^2 i_0' / 6,    error h^4 i''' / 72,
 * with i_1 from a first estimate of third order. The torque is integrated the same way. The error of the current in a segment
 * of length h is about (R/L) (h^4 i'''/72) + (R h/L)/3 (R/L) (h^3 i''/6). With 1/tau = max(R/L, omega_e) and i' = u/L this is
 * (u h/L) (h/tau)^3 / 12: for the motors of the reference design about 1e-7 A in 10 us and 1e-5 A in 30 us. Whole runs
 * agree with an independent integration within 1.1e-5 A (the converter's step is 4e-3 A), and within 2e-4 A with random gate
 * patterns and shafts at up to 700 rad/s.
 *
 * Linear intervals (switched_inverter_interval.c) take less than a third of the computing time of this general integration. They
 * apply while the shaft does not change between motion and rest, no phase is shorted and the iron does not saturate. Whole runs
 * then agree within 1e-4 A, and 1e-3 A with random gates.
 *
 * With saturated iron i is a function of the flux in the rotor reference frame (saturation.h) and L^-1 is the differential
 * one. There are no linear intervals then.
 *
 * Broken wires: the interval of an open leg is unlimited, that of a leg shorted to bus minus has zero width. Two legs shorted to
 * each other act as one: the third leg's current decides on their voltage.
 *
 * The end of a segment is found in closed form: a current zero crossing by its slope, refined with the slope found there (in a
 * linear interval as segment_trajectory.h says); a shaft that stops or starts by the root of a parabola; a floating leg that
 * reaches a limit of its interval by linear interpolation. An event that is due in less than a minimum time is treated as
 * already passed: otherwise repeated events at one instant would use up the parts of a segment.
 */
#ifndef PLANT_SWITCHED_INVERTER_H
#define PLANT_SWITCHED_INVERTER_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "board_clock.h"
#include "plant/motor.h"

/* Gate signals of one leg: bit 0 the upper switch, bit 1 the lower one. */
typedef enum {
    GATES_OPEN = 0,
    GATES_HIGH = 1,
    GATES_LOW = 2,
} inverter_gates_t;

#define INVERTER_BUS_CHANGE_MAX 0.05 /* change of the bus voltage that ends a segment [V] */
#define INVERTER_CLOCK_HZ (BOARD_CLOCK_MHZ * 1e6)
#define LINEAR_INTERVAL_MAX 64e-6 /* longest linear interval, without its last segment [s] */

/* A stator vector together with its phases in one vector register: alpha (which is phase a), beta, phase b, phase c. */
#define INVERTER_LANES 4
#define INVERTER_LANE(phase) ((phase) + ((phase) > 0))

/* A set of legs is a bit mask of lanes, 0 .. 13; tables have an entry for each value. */
#define INVERTER_LEG(phase) (1u << INVERTER_LANE(phase))
#define INVERTER_LEGS 13u
#define INVERTER_LEG_SETS (INVERTER_LEGS + 1u)
#define INVERTER_LOWER 8 /* offset of the lower gates' bits from those of the upper gates */
#define INVERTER_BOTH_GATES(leg) ((leg) | (leg) << INVERTER_LOWER)

/* Size of the tables whose product is the amplifiers' exponential decay e^(-n clocks / tau). */
#define INVERTER_DECAY 32

/* Symmetric matrix, (aa ab; ab bb). */
typedef struct {
    double aa, ab, bb; /* here [H] or [1/H] */
} symmetric_matrix_t;

/* Linear interval: a short time in which the currents obey i' = L^-1 v + K i + e + e' t with constant L^-1, K, e, e'. */
typedef struct {
    /* present segment */
    double i[INVERTER_LANES], di[INVERTER_LANES], ddi[INVERTER_LANES]; /* at its beginning [A], [A/s], [A/s^2] */
    double v[INVERTER_LANES]; /* leg voltages: alpha, beta, mean of the legs, unused [V] */
    /* coefficients */
    double inverse[2][INVERTER_LANES]; /* L^-1 by columns [1/H] */
    double state_matrix[2][INVERTER_LANES]; /* K by columns [1/s] */
    double emf_term[INVERTER_LANES], emf_term_slope[INVERTER_LANES]; /* e [A/s], e' [A/s^2] */
    double di_per_volt[3][INVERTER_LANES]; /* change of i' per volt at a leg [1/H] */
    double ddi_per_volt[3][INVERTER_LANES]; /* change of i'' per volt at a leg [1/(H s)] */
    double minus_l_leg[INVERTER_LANES]; /* minus the inductance seen from a leg; lane beta unused [H] */
    /* sums */
    plant_vector_t charge, moment; /* integral of i since the beginning, and its integral [A s], [A s^2] */
    double i_squared[2], energy_in[2]; /* integrals of 3/2 i^2 [A^2 s] and of v i [V A s], alpha and beta */
    double energy_drawn; /* from the bus, less the energy saved by zero crossings [J] */
    double floating_slope; /* voltage slope of the floating leg in the present segment [V/s] */
    double duration_max; /* duration of the interval, without its last segment [s] */
    double segment_max[2]; /* longest segment with a voltage across the motor, and without [s] */
    double reluctance_torque; /* at the beginning [N m] */
    double elapsed; /* since the beginning; angle, speed and flux are those of the beginning [s] */
} linear_interval_t;

/* Conduction state: sets of legs. */
typedef struct {
    unsigned upper; /* connected to the positive rail */
    unsigned reversed; /* current out of the motor: the drop adds to the leg's voltage */
    unsigned lower; /* connected to the negative rail, through the shunt */
} conduction_t;

/* Vectors come first: if the structure is aligned to a cache line, no vector lies across two lines. */
typedef struct {
    linear_interval_t interval; /* valid while `in_interval` */
    double accel; /* [rad/s^2] */
    double amplifier[INVERTER_LANES]; /* output of the current amplifiers [A] */
    double drops[INVERTER_LEG_SETS][INVERTER_LANES]; /* drop part of `v`, by `conduction.reversed` [V] */
    /* state */
    plant_vector_t psi; /* stator flux linkage [V s] */
    double theta, omega; /* mechanical [rad], [rad/s] */
    unsigned positive, negative; /* sets of legs by the sign of their current; in neither set: zero current */
    /* present segment, valid while `segment_valid`; drop_vector, leg_mean and dtorque only outside of a linear interval */
    bool segment_valid;
    bool held_at_stop; /* the shaft has just stopped and rests until the end of the segment */
    bool non_conducting; /* no current flows, and none will begin */
    bool in_interval; /* a linear interval is in progress */
    int floating; /* the only leg without current, -1: none */
    plant_vector_t switch_vector; /* a of v = u a + b: legs at the positive rail, Clarke transform */
    plant_vector_t drop_vector; /* b of v = u a + b [V] */
    plant_vector_t i, di; /* [A], [A/s] */
    double phase[3]; /* phase currents [A] */
    double u; /* bus voltage [V] */
    double floating_volts; /* voltage of the floating leg at the beginning [V] */
    conduction_t conduction;
    double leg_mean; /* mean of the leg voltages above the negative rail [V] */
    double dtorque; /* slope of the torque [N m/s] */
    double jerk; /* [rad/s^3] */
    double direction; /* direction of motion: 1, -1; 0: standstill [1] */
    double k_max, emf_term_max; /* bounds of K and e' of i'' = K i' + e' [1/s], [A/s^2] */
    bool trajectory_changed; /* motion of the shaft no longer as extrapolated; cleared by the reader */
    /* derived from the state */
    double cosine, sine; /* electrical angle [1] */
    symmetric_matrix_t inverse; /* L^-1 in the stator reference frame [1/H] */
    double torque; /* air gap [N m] */
    unsigned rotations; /* incremental updates of cosine and sine since they were evaluated */
    /* inputs */
    unsigned gates; /* set of upper gates that are on | lower gates << INVERTER_LOWER */
    double load; /* torque against positive motion [N m] */
    bool locked, unplugged;
    bool saturates; /* the iron saturates; inv_l_* are then differential, at the beginning of a step */
    double stop_min, stop_max; /* inelastic end stops, mechanical [rad] */
    double beyond_rail[3]; /* how far a leg's interval exceeds the rails; very large: open phase [V] */
    int requested_grounded, requested_unshorted; /* `grounded` and `unshorted` as requested, whatever phase is open */
    int grounded; /* leg shorted to bus minus, -1: none */
    int unshorted; /* the other two legs are shorted to each other, -1: no such short */
    bool shorted; /* one of the two shorts exists */
    unsigned joined; /* the two legs shorted to each other; only the sum of their currents matters */
    unsigned separate; /* legs without a short */
    /* parameters */
    double v_drop; /* forward drop [V] */
    double r_s, r_on, r; /* winding, switch or diode, their sum [ohm] */
    double l_d, l_q; /* without current [H] */
    double per_s_d, per_s_q; /* saturation_t.per_s of the two axes [1/(V s)] */
    double inv_l_mean, inv_l_half; /* half the sum and half the difference of 1 / L_d and 1 / L_q [1/H] */
    double psi_m; /* magnet's flux linkage [V s] */
    double pole_pairs; /* [1] */
    double inv_l_max; /* the larger one of 1 / L_d and 1 / L_q [1/H] */
    double saliency; /* the larger one of 1 / L_d and 1 / L_q over the smaller one [1] */
    double coupling; /* bound of the slope change in another phase per slope change in one [1] */
    double k_torque; /* 3/2 p [1] */
    double inv_inertia; /* [1/(kg m^2)] */
    double friction, viscous; /* Coulomb [N m], viscous [N m s] */
    double step_max; /* longest step of the general integration [s] */
    double tau; /* time constant of the current amplifiers [s] */
    double decay_fine[INVERTER_DECAY], decay_coarse[INVERTER_DECAY + 1]; /* [1]; the last one is 0 */
    /* sums since the beginning */
    double e_copper, e_switch; /* losses in windings, in switches and diodes [J] */
    double e_bus; /* energy drawn from the bus [J] */
    plant_vector_t charge; /* integral of i [A s] */
    double impulse; /* integral of the torque [N m s] */
    double leg_mean_integral; /* [V s] */
} switched_inverter_t;

/* Integrals of the terminal voltages above the negative rail, while the winding's resistance is constant [V s]. */
typedef struct {
    double volts[3]; /* [V s] */
} terminal_integral_t;

/* All gates off, no current, shaft at rest. */
void switched_inverter_init(switched_inverter_t *inverter, const plant_axis_t *config);

/* New parameters, with the winding's resistance `r_s` [ohm]. The currents are kept, the flux changes. Friction is not set. */
void switched_inverter_change(switched_inverter_t *inverter, const plant_axis_t *config, double r_s);

/* End a linear interval, so that flux, angle, speed, losses and charge are those of the present instant; the currents always
 * are. Call it before an input except the gates is changed, or one of these values is read. */
void switched_inverter_sync(switched_inverter_t *inverter);

/* Begin a segment with the present gates and currents at the bus voltage `u_dc` [V]. */
void switched_inverter_begin(switched_inverter_t *inverter, double u_dc);

/* Advance by `h` seconds, in which the bus voltage has the mean `u`. Returns the charge drawn from the bus [A s]. */
double switched_inverter_advance(switched_inverter_t *inverter, double h, double u);

/* Current drawn from the bus at the beginning of the segment [A]. */
static inline double switched_inverter_bus_current(const switched_inverter_t *inverter)
{
    return 1.5 * (inverter->switch_vector.alpha * inverter->i.alpha + inverter->switch_vector.beta * inverter->i.beta);
}

/* Slope of that current [A/s]. */
static inline double switched_inverter_bus_current_slope(const switched_inverter_t *inverter)
{
    return 1.5 *
           (inverter->switch_vector.alpha * inverter->di.alpha + inverter->switch_vector.beta * inverter->di.beta);
}

/* All gates with those of one leg replaced; two that are on at once are taken as off. */
static inline unsigned switched_inverter_gates_with(const switched_inverter_t *inverter, int phase, unsigned gates)
{
    static const uint16_t pair[] = {[GATES_HIGH] = 1u, [GATES_LOW] = 1u << INVERTER_LOWER, [3] = 0};
    const unsigned lane = (unsigned)INVERTER_LANE(phase);
    return (inverter->gates & ~(INVERTER_BOTH_GATES(1u) << lane)) | (unsigned)pair[gates] << lane;
}

/* True if the slopes of the present segment are invalid because of the change of the bus voltage. */
static inline bool switched_inverter_bus_changed(const switched_inverter_t *inverter, double u)
{
    return u > inverter->u + INVERTER_BUS_CHANGE_MAX || u < inverter->u - INVERTER_BUS_CHANGE_MAX;
}

/* Outputs of the amplifiers `h` seconds into the segment, at the bus voltage `u` [A]; false if the segment ends before. */
bool switched_inverter_amplifiers(const switched_inverter_t *inverter, double h, double u,
                                  double shown[INVERTER_LANES]);

/* True if `gates`, which differ in one leg, change nothing now and have changed nothing in the `h` seconds since the segment
 * began: the diode across the switch conducts anyway, as in a dead time. `u` is the present bus voltage [V]. */
bool switched_inverter_edge_has_no_effect(switched_inverter_t *inverter, int phase, unsigned gates, double h, double u);

/* Restart a segment of zero length: its decisions about legs without current are void. */
void switched_inverter_restart(switched_inverter_t *inverter);

/* Integrals up to the present instant; no switched_inverter_sync is needed. */
terminal_integral_t switched_inverter_integral(const switched_inverter_t *inverter);

/* Current in the shunt of a phase at the beginning of the segment [A]. */
double switched_inverter_shunt(const switched_inverter_t *inverter, int phase);

void switched_inverter_set_winding(switched_inverter_t *inverter, double r_s); /* resistance [ohm] */
void switched_inverter_set_magnet(switched_inverter_t *inverter, double psi_m); /* after switched_inverter_sync [V s] */
void switched_inverter_plug(switched_inverter_t *inverter, bool plugged); /* motor cable */

/* Open the wire of a phase, or close it. */
void switched_inverter_open(switched_inverter_t *inverter, int phase, bool open);

/* Short leg `grounded` to bus minus, or the two legs other than `unshorted` to each other; -1: no such short. */
void switched_inverter_short(switched_inverter_t *inverter, int grounded, int unshorted);

#endif
