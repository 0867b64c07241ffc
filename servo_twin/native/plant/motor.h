/* motor.h - permanent-magnet synchronous motor with its shaft.
 *
 * Rotor frame (DRM E18-E22 with L_d and L_q kept apart), amplitude-invariant vectors (k = 2/3, DRM E2-E7):
 *   L_d d(i_d)/dt = u_d - R i_d + w_e L_q i_q
 *   L_q d(i_q)/dt = u_q - R i_q - w_e (L_d i_d + psi_m)
 *   T_e = 3/2 p (psi_d i_q - psi_q i_d),  psi_d = psi_m + L_d i_d,  psi_q = L_q i_q
 *   J d(w_m)/dt = T_e - T_load - B w_m - T_friction
 * T_friction is Coulomb friction: against the motion, and at standstill equal to the driving torque up to its limit.
 * With saturated iron (saturation.h) the fluxes are integrated, and the currents are functions of them.
 */
#ifndef PLANT_MOTOR_H
#define PLANT_MOTOR_H

#include <stdbool.h>

#include "board.h"
#include "plant/saturation.h"

/* Lower speeds count as standstill; otherwise a stop could follow after zero time [rad/s]. */
#define PLANT_STANDING 1e-9

/* Steps between two evaluations of sine and cosine; in between they are rotated incrementally. */
#define PLANT_FRESH_TRIG 64u

typedef struct {
    /* parameters */
    double r;            /* stator and the switch in series with it [ohm] */
    double inv_r;        /* [S] */
    double l_d, l_q;     /* flux over current [H] */
    double inv_l_d, inv_l_q; /* inverse differential inductances [1/H] */
    double psi_m;        /* magnet's flux linkage [V s] */
    double pole_pairs; /* [1] */
    double inv_inertia;  /* [1 / (kg m^2)] */
    double friction;     /* Coulomb [N m] */
    double viscous;      /* [N m s] */
    double torque_psi;   /* 3/2 p psi_m [N m/A] */
    double torque_l;     /* 3/2 p (L_d - L_q) [N m/A^2] */
    /* inputs */
    double load;         /* external torque against positive motion [N m] */
    bool locked;         /* shaft */
    double low, high;    /* end stops, inelastic, mechanical [rad] */
    bool obstructed;     /* motion limited by end stops */
    bool fine;           /* needs shorter steps than the plant (shaft.h) */
    bool single;         /* obstructed or fine: excluded from the pair of both axes (motor_pair.h) */
    bool saturates;      /* the iron saturates */
    /* state */
    double i_d, i_q;     /* [A] */
    double omega;        /* mechanical [rad/s] */
    double theta;        /* mechanical, not wrapped [rad] */
    /* derived from the state */
    double sine, cosine; /* electrical angle [1] */
    unsigned steps;      /* steps since sine and cosine were evaluated */
    double phase[3];     /* phase currents into the motor [A] */
    saturation_t iron_d, iron_q; /* parameters */
} plant_motor_t;

/* Stator voltage in the stator frame, constant over a step [V]. */
typedef struct {
    double alpha, beta; /* [V]; of other vectors in their own unit */
} plant_vector_t;

void plant_motor_init(plant_motor_t *motor, const plant_axis_t *config);

/* New parameters but the friction, which includes the holding brake; the state is kept. */
void plant_motor_change(plant_motor_t *motor, const plant_axis_t *config);

/* Resistances [ohm] and magnet's flux linkage [V s] at new temperatures. */
void plant_motor_warm(plant_motor_t *motor, double r_s, double r_on, double psi_m);

/* One Runge-Kutta step of at most `dt` [s] with all windings connected. Ends early where the shaft
 * stops, since friction changes there. Returns the length of the step (> 0) [s]. */
double plant_motor_step(plant_motor_t *motor, plant_vector_t u, double dt);

/* The same without current and torque. */
double plant_motor_coast(plant_motor_t *motor, double dt);

/* Set the phase currents [A]; their sum is 0. */
void plant_motor_set_phases(plant_motor_t *motor, double i_a, double i_b);

/* The motor needs shorter steps, or no longer. */
void plant_motor_set_fine(plant_motor_t *motor, bool fine);

void plant_motor_lock(plant_motor_t *motor, bool locked);

/* Inelastic end stops at these distances from the present angle [rad]. */
void plant_motor_obstruct(plant_motor_t *motor, double below, double above);

/* Evaluate sine, cosine and phase currents from angle and currents. */
void plant_motor_refresh_exact(plant_motor_t *motor);

/* Count a step; evaluates sine, cosine and phase currents from time to time. */
static inline void plant_motor_count_step(plant_motor_t *motor)
{
    if (++motor->steps > PLANT_FRESH_TRIG) {
        plant_motor_refresh_exact(motor);
    }
}

double plant_motor_torque(const plant_motor_t *motor); /* air gap [N m] */

/* Back-EMF of the phases [V]. */
void plant_motor_back_emf(const plant_motor_t *motor, double emf[3]);

/* By two selections, which compilers turn into minimum and maximum instructions. */
static inline double plant_limit(double x, double low, double high)
{
    const double y = (x < low) ? low : x;
    return (y > high) ? high : y;
}

/* Clarke transform of three phases (DRM E2-E7). */
static inline plant_vector_t plant_clarke(const double abc[3])
{
    const plant_vector_t v = {(2.0 * abc[0] - abc[1] - abc[2]) * (1.0 / 3.0),
                              (abc[1] - abc[2]) * 0.57735026918962576451};
    return v;
}

#endif
