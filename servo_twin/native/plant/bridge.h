/* bridge.h - one inverter with its motor, between two edges of its gates.
 *
 * Legs. What a leg can do depends on its gates and on the sign of its current i (into the motor); u is the bus voltage,
 * V the drop of a switch or diode (their resistance is part of the motor's circuit, being in series with the phase
 * whatever conducts):
 *
 *   gates            i > 0           i < 0           i = 0
 *   upper on         u - V (switch)  u + V (diode)   anything between the two
 *   lower on          -V  (diode)      V  (switch)    ''
 *   both off          -V  (diode)    u + V (diode)    ''
 *
 * So every leg is a voltage interval: at its lower end the current is positive, at its upper end negative, and a leg
 * whose current is zero takes the voltage inside that keeps it there, for as long as there is one.
 *
 * Motor, in the stator frame (DRM E11-E15 with L_d and L_q kept apart, amplitude-invariant vectors):
 *   d(psi)/dt = v - R i,    i = e^{j theta_e} L^-1 (e^{-j theta_e} psi - psi_m)
 *   T_e = 3/2 p psi x i,    J d(omega)/dt = T_e - T_load - B omega - T_friction
 * A segment is a stretch in which no gate changes and, but in a frame, no current its sign, so the legs' part of v is known:
 * u a + b with constant vectors a, b. The voltage enters psi as its integral, without error. Only R i has to be
 * integrated, by the quadrature that is exact for a current of second order,
 *   Q = h (2 i_0 + i_1) / 3 + h^2 i_0' / 6,    error h^4 i''' / 72,
 * with i_1 from a first guess of third order; the torque is integrated the same way. In a segment of length h the current
 * is wrong by about (R/L) (h^4 i'''/72) + (R h/L)/3 (R/L) (h^3 i''/6): with 1/tau = max(R/L, omega_e) and i' = u/L this is
 * (u h/L) (h/tau)^3 / 12, for the motors of the reference design some 1e-7 A in 10 us and 1e-5 A in 30 us. Whole runs
 * against an independent integration stay within 1.1e-5 A (the converter's step is 4e-3 A), 2e-4 A with gates that follow
 * no modulation and shafts at up to 700 rad/s.
 *
 * While nothing unusual happens and no leg touches anything segments are parabolas within a frame (bridge_frame.c), which
 * costs less than a third; whole runs stay within 1e-4 A then, and 1e-3 A with such gates.
 *
 * Where the iron saturates i is a function of the flux in the rotor frame (saturation.h), which the voltages make without error,
 * and L^-1 that of small changes; there are no frames then.
 *
 * Broken wires: the interval of an open leg has no ends, that of a leg on bus minus no width, and two legs that touch go
 * together: the third one's current alone decides on their voltage.
 *
 * Where a segment ends within itself is found in closed form: a current at zero by its slope, corrected by the slopes found
 * there (in a frame as bridge_course.h says); a shaft that stops or breaks loose by the root of a parabola; a floating leg
 * that reaches an end of its interval by a straight line. What would take no time has happened already: an instant that
 * came again and again would use up the parts of a segment.
 */
#ifndef PLANT_BRIDGE_H
#define PLANT_BRIDGE_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "plant/motor.h"

/* Gate signals of one leg: bit 0 the upper switch, bit 1 the lower one. */
typedef enum {
    BRIDGE_OPEN = 0,
    BRIDGE_HIGH = 1,
    BRIDGE_LOW = 2,
} bridge_gates_t;

#define BRIDGE_MOVED 0.05 /* of the bus, so that a segment is better begun anew [V] */
#define BRIDGE_CLOCK_HZ 100e6 /* bus clock of the chip */
#define BRIDGE_FRAME 64e-6 /* angle and speed are brought along so often, but for the last segment [s] */

/* A stator vector together with its phases in one register: alpha (which is phase a), beta, phase b, phase c. */
#define BRIDGE_LANES 4
#define BRIDGE_LANE(phase) ((phase) + ((phase) > 0))

/* Where there is a bit for each leg it lies as the lanes do; 14 numbers hold them all. */
#define BRIDGE_LEG(phase) (1u << BRIDGE_LANE(phase))
#define BRIDGE_LEGS 13u
#define BRIDGE_LEG_SETS (BRIDGE_LEGS + 1u)
#define BRIDGE_LOWER 8 /* by so many bits the lower gates lie above the upper ones */
#define BRIDGE_BOTH(leg) ((leg) | (leg) << BRIDGE_LOWER) /* gates of a leg */

/* Decay of the amplifiers, e^(-n clocks / tau), as the product of two entries. */
#define BRIDGE_DECAY 32

/* Symmetric matrix, (aa ab; ab bb). */
typedef struct {
    double aa, ab, bb;
} bridge_matrix_t;

/* A short time in which the currents obey an equation with constant coefficients. */
typedef struct {
    /* the segment */
    double i[BRIDGE_LANES], di[BRIDGE_LANES], ddi[BRIDGE_LANES]; /* where it begins [A], [A/s], [A/s^2] */
    double v[BRIDGE_LANES];              /* of the legs: alpha, beta, their mean, nothing [V] */
    /* coefficients */
    double inverse[2][BRIDGE_LANES];     /* by columns: i' with v [1/H] */
    double drift[2][BRIDGE_LANES];       /* by columns: i' with i [1/s] */
    double push[BRIDGE_LANES], push_slope[BRIDGE_LANES]; /* i' without either, and how it changes [A/s], [A/s^2] */
    double along[3][BRIDGE_LANES];       /* i' with a volt at a leg [1/H] .. */
    double bend[3][BRIDGE_LANES];        /* .. and i'' [1/(H s)] */
    double hold[BRIDGE_LANES];           /* volts at a leg per slope of its current that undo it; beta: any [H] */
    /* sums */
    plant_vector_t charge, moment;       /* since its beginning, and the integral of that [A s], [A s^2] */
    double squares[2], work[2];          /* integrals of 3/2 i^2 [A^2 s] and of v i [V A s], alpha and beta */
    double taken;                        /* out of the bus, less what passes through zero have saved [J] */
    double hold_slope;                   /* of the floating leg in the segment [V/s] */
    double longest;                      /* without its last segment [s] */
    double longest_segment[2];           /* with a voltage across the motor, and with none: never shorter [s] */
    double reluctance;                   /* part of the torque at the beginning [N m] */
    double time;                         /* since its beginning [s]: angle, speed and flux stand there */
} bridge_frame_t;

/* Ways through the legs, a bit for each. */
typedef struct {
    unsigned upper;                      /* from the positive rail */
    unsigned raised;                     /* with the drop counting upwards: current out of the motor */
    unsigned lower;                      /* through the shunt */
} bridge_paths_t;

/* What a frame reads as vectors comes first: if the bridge begins a line of the cache, none of that lies across two. */
typedef struct {
    bridge_frame_t frame;                /* while nothing unusual happens (bridge_frame.c) */
    double accel;                        /* [rad/s^2] */
    double amplifier[BRIDGE_LANES];      /* output of the current amplifiers [A] */
    double drops[BRIDGE_LEG_SETS][BRIDGE_LANES]; /* by the legs with a current out of the motor, as `v` of a frame */
    /* state */
    plant_vector_t psi;                  /* stator flux linkage [V s] */
    double theta, omega;                 /* mechanical [rad], [rad/s] */
    unsigned positive, negative;         /* signs of the phase currents; neither: the leg floats */
    /* the segment that begins here, valid while `begun`; b, level and dtorque only outside of a frame */
    bool begun;
    bool held;                           /* the shaft has just stopped and stays so to the end of the segment */
    bool dead;                           /* no current at all, and none will flow */
    bool framed;
    int floating;                        /* index of the only leg without current, -1 if there is none */
    plant_vector_t a, b;                 /* v = u a + b */
    plant_vector_t i, di;                /* [A], [A/s] */
    double phase[3];                     /* [A] */
    double u;                            /* bus voltage [V] */
    double hold;                         /* of the floating leg at the beginning [V] */
    bridge_paths_t paths;                /* through the legs */
    double level;                        /* mean of the legs above the negative rail [V] */
    double dtorque;                      /* [N m/s] */
    double jerk;                         /* [rad/s^3] */
    double direction;                    /* of motion, 1 or -1; 0: stands */
    double k_most, push_most;            /* of i'' = K i' + e' (bridge_frame.c), at most [1/s], [A/s^2] */
    bool moved;                          /* angle and speed are others than before: set here, cleared by who looks */
    /* what follows from the state */
    double cosine, sine;                 /* of the electrical angle */
    bridge_matrix_t inverse;             /* inductance^-1 in the stator frame [1/H] */
    double torque;                       /* [N m] */
    unsigned turns;                      /* of cosine and sine since they were made afresh */
    /* inputs */
    unsigned gates;                      /* that are on: upper ones, and lower ones << BRIDGE_LOWER */
    double load;                         /* [N m] */
    bool locked, unplugged;
    bool saturates; /* inv_l_.. are those of small changes then, of the currents where a step begins */
    double low, high; /* end stops, inelastic, mechanical [rad] */
    double reach[3]; /* of a leg's interval beyond the rails, without end for an open phase [V] */
    int shorted_leg, shorted_beside; /* the next two, were no phase open */
    int grounded; /* leg that touches bus minus, -1: none */
    int alone; /* the other two legs touch each other, -1: they do not */
    bool shorted; /* one of the two */
    unsigned joint; /* the two that touch: their own currents tell nothing */
    unsigned own; /* the others, but for a grounded one */
    /* parameters */
    double v_drop; /* [V] */
    double r_s, r_on, r; /* winding, switch or diode, their sum [ohm] */
    double l_d, l_q; /* without current */
    double per_s_d, per_s_q; /* where they saturate (saturation.h) [1 / (V s)] */
    double inv_l_mean, inv_l_half; /* half the sum and half the difference of 1 / L_d and 1 / L_q */
    double psi_m, pole_pairs;
    double inv_l_most, saliency; /* the larger of 1 / L_d and 1 / L_q; over the smaller one */
    double coupling; /* of what a phase's slope changes by, how much may be in another one */
    double k_torque; /* 3/2 p */
    double inv_inertia;
    double friction, viscous;
    double longest; /* step that the series are good for [s] */
    double tau; /* of the current amplifiers [s] */
    double decay_fine[BRIDGE_DECAY], decay_coarse[BRIDGE_DECAY + 1]; /* the last one is 0 */
    /* sums since the beginning */
    double e_copper, e_switch; /* [J] */
    double e_bus; /* taken out of the bus [J] */
    plant_vector_t charge; /* [A s] */
    double volt_seconds_0; /* of the legs' mean [V s] */
} bridge_t;

/* Integrals of the terminals' voltages above the negative rail, while the winding's resistance is constant [V s]. */
typedef struct {
    double volts[3];
} bridge_integral_t;

/* All gates off, no current, shaft at rest. */
void bridge_init(bridge_t *bridge, const plant_axis_t *config);

/* Other parameters from now on, with the winding at `r_s`: the currents go on, and the flux is another one. The friction stays. */
void bridge_change(bridge_t *bridge, const plant_axis_t *config, double r_s);

/* Bring flux, angle and speed along; currents and sums always are. To be called before anything but gates is changed from
 * outside, or looked at. */
void bridge_settle(bridge_t *bridge);

/* Look at the present gates, currents and bus voltage: how this segment begins. */
void bridge_begin(bridge_t *bridge, double u_dc);

/* Move on by `h` seconds, in which the bus voltage has the mean `u`. Returns the charge taken out of the bus [A s]. */
double bridge_advance(bridge_t *bridge, double h, double u);

/* Current out of the bus at the beginning of the segment, and its slope [A], [A/s]. */
static inline double bridge_drain(const bridge_t *bridge)
{
    return 1.5 * (bridge->a.alpha * bridge->i.alpha + bridge->a.beta * bridge->i.beta);
}

static inline double bridge_drain_slope(const bridge_t *bridge)
{
    return 1.5 * (bridge->a.alpha * bridge->di.alpha + bridge->a.beta * bridge->di.beta);
}

/* All gates, as they are kept, with these on one leg; two that are on at once are taken for none. */
static inline unsigned bridge_gates_with(const bridge_t *bridge, int phase, unsigned gates)
{
    static const uint16_t pair[] = {[BRIDGE_HIGH] = 1u, [BRIDGE_LOW] = 1u << BRIDGE_LOWER, [3] = 0};
    const unsigned lane = (unsigned)BRIDGE_LANE(phase);
    return (bridge->gates & ~(BRIDGE_BOTH(1u) << lane)) | (unsigned)pair[gates] << lane;
}

/* The bus has moved, so that the slopes are no longer those that the segment began with. */
static inline bool bridge_is_stale(const bridge_t *bridge, double u)
{
    return u > bridge->u + BRIDGE_MOVED || u < bridge->u - BRIDGE_MOVED;
}

/* What the amplifiers show `h` seconds into the segment, the bus at `u` by now; false if something changes before. */
bool bridge_amplifiers(const bridge_t *bridge, double h, double u, double shown[BRIDGE_LANES]);

/* True if `gates`, others on one leg, would change nothing, now and in the `h` seconds since the segment began: a dead time
 * that the diode has bridged already, or is about to. The bus is at `u` by now. */
bool bridge_indifferent(bridge_t *bridge, int phase, unsigned gates, double h, double u);

/* A segment that has taken no time is to begin anew: what it has decided about legs without current does not count. */
void bridge_begin_again(bridge_t *bridge);

/* Up to where the bridge stands; flux, angle and speed need not be brought along. */
bridge_integral_t bridge_integral(const bridge_t *bridge);

/* What the shunt of a phase carries at the beginning of the segment. */
double bridge_shunt(const bridge_t *bridge, int phase);

void bridge_set_winding(bridge_t *bridge, double r_s); /* as the copper warms up */
void bridge_set_magnet(bridge_t *bridge, double psi_m); /* the same of the magnet; settled before */
void bridge_plug(bridge_t *bridge, bool plugged);

/* The wire of a phase breaks, or is mended. */
void bridge_open(bridge_t *bridge, int phase, bool open);

/* Leg `grounded` touches bus minus, or the two beside `alone` touch each other; -1: they do not. */
void bridge_short(bridge_t *bridge, int grounded, int alone);

#endif
