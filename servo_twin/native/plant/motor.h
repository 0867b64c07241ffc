/* motor.h - permanent-magnet synchronous motor with its shaft.
 *
 * Rotor frame (DRM E18-E22 with L_d and L_q kept apart), amplitude-invariant vectors (k = 2/3, DRM E2-E7):
 *   L_d d(i_d)/dt = u_d - R i_d + w_e L_q i_q
 *   L_q d(i_q)/dt = u_q - R i_q - w_e (L_d i_d + psi_m)
 *   T_e = 3/2 p (psi_d i_q - psi_q i_d),  psi_d = psi_m + L_d i_d,  psi_q = L_q i_q
 *   J d(w_m)/dt = T_e - T_load - B w_m - T_friction
 * T_friction is Coulomb's: against the motion while it lasts; at standstill whatever holds the shaft, up to its limit.
 * Where the iron saturates (saturation.h) the fluxes are integrated, of which the currents are functions.
 */
#ifndef PLANT_MOTOR_H
#define PLANT_MOTOR_H

#include <stdbool.h>

#include "board.h"
#include "plant/saturation.h"

/* Slower is standing: otherwise a stop could come after no time at all [rad/s]. */
#define PLANT_STANDING 1e-9

/* Steps between two evaluations of sine and cosine from the angle; in between they are turned on. */
#define PLANT_FRESH_TRIG 64u

typedef struct {
    /* parameters */
    double r;            /* stator and the switch in series with it [ohm] */
    double inv_r;        /* [S] */
    double l_d, l_q;     /* flux over current [H] */
    double inv_l_d, inv_l_q; /* for small changes */
    double psi_m;        /* [V s] */
    double pole_pairs;
    double inv_inertia;  /* [1 / (kg m^2)] */
    double friction;     /* [N m] */
    double viscous;      /* [N m s] */
    double torque_psi;   /* 3/2 p psi_m */
    double torque_l;     /* 3/2 p (L_d - L_q) */
    /* inputs */
    double load;         /* external torque against positive motion [N m] */
    bool locked;         /* shaft held fast */
    double low, high;    /* end stops, inelastic, mechanical [rad] */
    bool obstructed;     /* there are some */
    bool fine;           /* takes steps of its own (shaft.h) */
    bool apart;          /* one of these two: no plain case (pair.h) */
    bool saturates;
    /* state */
    double i_d, i_q;     /* [A] */
    double omega;        /* mechanical [rad/s] */
    double theta;        /* mechanical, not wrapped [rad] */
    /* what follows from the state */
    double sine, cosine; /* of the electrical angle */
    unsigned steps;      /* since these two were evaluated */
    double phase[3];     /* phase currents into the motor [A] */
    saturation_t iron_d, iron_q;
} plant_motor_t;

/* Stator voltage in the stator frame, constant over a step [V]. */
typedef struct {
    double alpha, beta;
} plant_vector_t;

void plant_motor_init(plant_motor_t *motor, const plant_axis_t *config);

/* Other parameters from now on, the friction not: that is the shaft's together with its brake. */
void plant_motor_change(plant_motor_t *motor, const plant_axis_t *config);

/* Resistance of the winding and flux of the magnet, as they warm up [ohm], [V s]. */
void plant_motor_warm(plant_motor_t *motor, double r_s, double r_on, double psi_m);

/* One Runge-Kutta step of at most `dt` [s] with all windings connected. Ends early where the shaft comes to a stop, so
 * that friction can be decided anew; returns the time that has passed (> 0). */
double plant_motor_step(plant_motor_t *motor, plant_vector_t u, double dt);

/* The same with open windings: no current, no torque. */
double plant_motor_coast(plant_motor_t *motor, double dt);

/* Set the currents from the phases [A]; their sum is 0. */
void plant_motor_set_phases(plant_motor_t *motor, double i_a, double i_b);

/* The motor takes steps of its own, or no longer. */
void plant_motor_part(plant_motor_t *motor, bool fine);

void plant_motor_lock(plant_motor_t *motor, bool locked);

/* End stops so far [rad] to both sides of where the shaft is now. */
void plant_motor_obstruct(plant_motor_t *motor, double below, double above);

/* Sine, cosine and phase currents anew from the angle. */
void plant_motor_refresh(plant_motor_t *motor);

/* Another step has been taken; now and then all of these are due. */
static inline void plant_motor_count_step(plant_motor_t *motor)
{
    if (++motor->steps > PLANT_FRESH_TRIG) {
        plant_motor_refresh(motor);
    }
}

double plant_motor_torque(const plant_motor_t *motor);

/* Phase voltages induced by the rotor, open windings [V]. */
void plant_motor_back_emf(const plant_motor_t *motor, double emf[3]);

/* Two selections in a row, which compilers turn into minimum and maximum instructions. */
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
