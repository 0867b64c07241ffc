/* shaft.h - what lies between a motor's rotor and its load, beside the bearing's friction: cogging, and a shaft that twists
 * before a second mass follows.
 *
 *   T_cogging = A sin(N theta + phi)                                  on the rotor
 *   twist     = theta - theta_load
 *   T_shaft   = k (twist -+ gap / 2) + d twist'   beyond the gap and while it pushes, or else 0
 *   J_load d(omega_load)/dt = T_shaft - T_load - T_friction,load
 *
 * The rotor is given one torque for a step of h seconds: spring and cogging of where angle and twist will be in the middle of the
 * step, which conserves energy (leapfrog): a resonance of w is found at w (1 + (w h)^2 / 24), stable up to w h = 2. The speed of
 * the twist there is that of this step and the one before, extrapolated.
 */
#ifndef PLANT_SHAFT_H
#define PLANT_SHAFT_H

#include <math.h>
#include <stdbool.h>

#include "board.h"
#include "plant/trig.h"

typedef struct {
    bool fine; /* there is something that takes steps shorter than those of the plant */
    bool two_masses;
    double stiffness; /* [N m/rad] */
    double damping; /* [N m s] */
    double half_gap; /* [rad] */
    double inv_inertia; /* of the load [1 / (kg m^2)] */
    double friction; /* of the load [N m] */
    double load; /* external, on the second mass [N m] */
    double cogging; /* amplitude [N m] */
    double periods, phase; /* of it, per turn, [rad] */
    double theta, omega; /* of the second mass at the end of the step [rad], [rad/s] */
    double accel; /* of it in the step [rad/s^2] */
    double speed; /* of the twist at the beginning of the step [rad/s] */
    double torque; /* through the shaft in the step [N m] */
} shaft_t;

/* Other parameters; a second mass that was not there moves with the rotor at theta and omega. */
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

/* Torque through the shaft with the twist in the middle of a step, and its speed there. */
static inline double shaft_torque(const shaft_t *s, double twist, double speed)
{
    const double deep = (twist > s->half_gap)    ? twist - s->half_gap
                        : (twist < -s->half_gap) ? twist + s->half_gap
                                                 : 0.0;
    const double torque = s->stiffness * deep + s->damping * speed;
    return (torque * deep > 0.0) ? torque : 0.0;
}

/* The second mass over a step with this torque: friction takes speed, but never turns it round. */
static inline void shaft_carry(shaft_t *s, double h)
{
    const double free = s->omega + h * (s->torque - s->load) * s->inv_inertia;
    const double brake = h * s->friction * s->inv_inertia;
    const double omega = (free > brake) ? free - brake : (free < -brake) ? free + brake : 0.0;
    s->theta += 0.5 * h * (s->omega + omega);
    s->accel = (omega - s->omega) / h;
    s->omega = omega;
}

/* A step of h seconds begins with the rotor at theta and omega: what acts against its positive motion meanwhile [N m]. */
static inline double shaft_step(shaft_t *s, double theta, double omega, double h)
{
    double against = 0.0;
    if (s->two_masses) {
        const double speed = omega - s->omega;
        s->torque = shaft_torque(s, theta - s->theta + 0.5 * h * speed, 1.5 * speed - 0.5 * s->speed);
        s->speed = speed;
        shaft_carry(s, h);
        against = s->torque;
    }
    if (s->cogging > 0.0) {
        double sine;
        double cosine;
        plant_sincos(s->periods * (theta + 0.5 * h * omega) + s->phase, &sine, &cosine);
        against -= s->cogging * sine;
    }
    return against;
}

#endif
