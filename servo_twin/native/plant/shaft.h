/* shaft.h - cogging torque, and an elastic shaft with backlash between the rotor and a second mass.
 *
 *   T_cogging = A sin(N theta + phi)                                  on the rotor
 *   twist     = theta - theta_load
 *   T_shaft   = k (twist -+ gap / 2) + d twist'   beyond the gap and while it pushes, otherwise 0
 *   J_load d(omega_load)/dt = T_shaft - T_load - T_friction,load
 *
 * The torque on the rotor is constant over a step of h seconds. Spring and cogging torque are those of angle and twist in the
 * middle of the step, which conserves energy (leapfrog): a resonance w appears at w (1 + (w h)^2 / 24); stable up to w h = 2.
 * The speed of the twist there is extrapolated from this step and the one before.
 */
#ifndef PLANT_SHAFT_H
#define PLANT_SHAFT_H

#include <math.h>
#include <stdbool.h>

#include "board.h"
#include "plant/trig.h"

#define SHAFT_SPEED_MAX 20000.0 /* [rad/s] */
#define SHAFT_TOO_FAST "a shaft is faster than 20000 rad/s: external torque or supply are too large"

/* No motor is so fast; encoder edges and voltages would be without bound, and at last not numbers: then `other`, a sum of
 * quantities of the axis, is none, even if friction has already set the speed to 0. */
static inline bool shaft_too_fast(double omega, double other)
{
    return !(fabs(omega) <= SHAFT_SPEED_MAX && isfinite(other));
}

typedef struct {
    bool fine; /* needs shorter steps than the plant: second mass, cogging or saturation */
    bool two_masses;
    double stiffness; /* shaft stiffness [N m/rad] */
    double damping; /* shaft damping [N m s] */
    double half_gap; /* half the backlash [rad] */
    double inv_inertia; /* second mass [1/(kg m^2)] */
    double friction; /* Coulomb friction of the second mass [N m] */
    double load; /* external torque on the second mass [N m] */
    double cogging; /* amplitude of the cogging torque [N m] */
    double periods, phase; /* cogging: periods per turn [1], phase [rad] */
    double theta, omega; /* second mass at the end of the step [rad], [rad/s] */
    double accel; /* acceleration of the second mass in the step [rad/s^2] */
    double speed; /* speed of the twist at the beginning of the step [rad/s] */
    double torque; /* shaft torque in the step [N m] */
} shaft_t;

/* New parameters; a new second mass starts with the rotor's theta [rad] and omega [rad/s]. */
static inline void shaft_change(shaft_t *s, const plant_axis_t *config, double theta, double omega)
{
    const bool begins = config->load_inertia > 0.0 && !s->two_masses;
    s->two_masses = config->load_inertia > 0.0;
    s->fine =
        s->two_masses || config->cogging_torque > 0.0 || config->i_saturation_d > 0.0 || config->i_saturation_q > 0.0;
    s->inv_inertia = s->two_masses ? 1.0 / config->load_inertia : 0.0;
    s->stiffness = config->shaft_stiffness;
    s->damping = config->shaft_damping;
    s->half_gap = 0.5 * config->backlash;
    s->friction = config->load_friction;
    s->load = config->load_torque;
    s->cogging = config->cogging_torque;
    s->periods = config->cogging_periods;
    s->phase = config->cogging_phase;
    if (begins) {
        s->theta = theta;
        s->omega = omega;
        s->torque = s->accel = s->speed = 0.0;
    }
}

/* Torque of the shaft [N m] at the twist [rad] in the middle of a step, and its speed there [rad/s]. */
static inline double shaft_torque(const shaft_t *s, double twist, double speed)
{
    const double beyond_gap = (twist > s->half_gap)    ? twist - s->half_gap
                              : (twist < -s->half_gap) ? twist + s->half_gap
                                                       : 0.0;
    const double torque = s->stiffness * beyond_gap + s->damping * speed;
    return (torque * beyond_gap > 0.0) ? torque : 0.0;
}

/* Step of the second mass; friction reduces the speed, but does not reverse it. */
static inline void shaft_step_load(shaft_t *s, double h)
{
    const double free = s->omega + h * (s->torque - s->load) * s->inv_inertia;
    const double brake = h * s->friction * s->inv_inertia;
    const double omega = (free > brake) ? free - brake : (free < -brake) ? free + brake : 0.0;
    s->theta += 0.5 * h * (s->omega + omega);
    s->accel = (omega - s->omega) / h;
    s->omega = omega;
}

/* Step of h seconds, with the rotor at theta [rad] and omega [rad/s] at its beginning. Returns the torque against the rotor's
 * positive motion in the step [N m]. */
static inline double shaft_step(shaft_t *s, double theta, double omega, double h)
{
    double torque = 0.0;
    if (s->two_masses) {
        const double speed = omega - s->omega;
        s->torque = shaft_torque(s, theta - s->theta + 0.5 * h * speed, 1.5 * speed - 0.5 * s->speed);
        s->speed = speed;
        shaft_step_load(s, h);
        torque = s->torque;
    }
    if (s->cogging > 0.0) {
        double sine;
        double cosine;
        plant_sincos(s->periods * (theta + 0.5 * h * omega) + s->phase, &sine, &cosine);
        torque -= s->cogging * sine;
    }
    return torque;
}

#endif
