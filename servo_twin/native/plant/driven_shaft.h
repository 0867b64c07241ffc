/* driven_shaft.h - a shaft whose motion is given from outside, by another simulator that owns its inertia.
 *
 * The motion is a cubic from the present angle and speed to those at the end of the given time, and continues at the speed at the
 * end. For the plant it is a shaft of infinite inertia: no torque moves it, and its speed in each step is the mean of the motion.
 *
 * Friction that holds a load at rest is stiff: the torque of the closed holding brake depends on the inertia and the time step of the
 * other simulator. It is that of a spring and a damper between the shaft and an angle that it holds, which slips at the torque of the
 * brake:
 *
 *   T = -(k x + d w), k = 0.086 J / h^2, d = 0.5 J / h, |T| <= T_brake
 *
 * With this torque constant in each step the motion is stable up to more than twice the given inertia, and close to aperiodic at it.
 */
#ifndef PLANT_DRIVEN_SHAFT_H
#define PLANT_DRIVEN_SHAFT_H

#include <stdbool.h>

#define BRAKE_STIFFNESS 0.086
#define BRAKE_DAMPING 0.5

typedef struct {
    bool on;
    bool braked; /* the brake was closed at the last call of driven_shaft_brake */
    double time, duration; /* since the beginning of the motion; of the motion [s] */
    double theta; /* at its end [rad] */
    double omega; /* at its end [rad/s] */
    double theta_0, omega_0, half_accel,
        sixth_jerk; /* coefficients of the cubic [rad], [rad/s], [rad/s^2], [rad/s^3] */
    double held; /* if braked: angle at which its spring is relaxed [rad] */
} driven_shaft_t;

static inline double driven_shaft_speed(const driven_shaft_t *s)
{
    const double t = s->time;
    return (t < s->duration) ? s->omega_0 + t * (2.0 * s->half_accel + t * (3.0 * s->sixth_jerk)) : s->omega;
}

/* Begin a motion at the present angle [rad] and, of a shaft not driven so far, speed [rad/s]; `late` seconds of it have passed. */
static inline void driven_shaft_begin(driven_shaft_t *s, double theta_0, double omega_0, double theta, double omega,
                                      double duration, double late)
{
    const double start = s->on ? driven_shaft_speed(s) : omega_0;
    const double mean = (theta - theta_0) / duration;
    *s = (driven_shaft_t){
        .on = true,
        .time = -late,
        .duration = duration,
        .theta = theta,
        .omega = omega,
        .theta_0 = theta_0,
        .omega_0 = start,
        .half_accel = (3.0 * mean - 2.0 * start - omega) / duration,
        .sixth_jerk = (start + omega - 2.0 * mean) / (duration * duration),
        .braked = s->braked,
        .held = s->held,
    };
}

/* Step of h seconds from the angle `theta` [rad]. Returns the mean speed in it [rad/s]. */
static inline double driven_shaft_step(driven_shaft_t *s, double theta, double h)
{
    s->time += h;
    const double t = s->time;
    const double target = (t < s->duration) ? s->theta_0 + t * (s->omega_0 + t * (s->half_accel + t * s->sixth_jerk))
                                            : s->theta + (t - s->duration) * s->omega;
    return (target - theta) / h;
}

/* Torque of the closed brake at the end of the motion for the next step of h seconds of the other simulator [N m]; `limit` is the torque
 * at which it slips [N m], `inertia` what it holds [kg m^2]. */
static inline double driven_shaft_brake(driven_shaft_t *s, double limit, double inertia, double h)
{
    const double stiffness = BRAKE_STIFFNESS * inertia / (h * h);
    const double damper = BRAKE_DAMPING * inertia / h * s->omega;
    if (!s->braked) {
        s->braked = true;
        s->held = s->theta;
    }
    const double torque = stiffness * (s->theta - s->held) + damper;
    const double least = (torque > limit) ? limit : (torque < -limit) ? -limit : torque;
    if (least != torque) {
        s->held = s->theta - (least - damper) / stiffness;
    }
    return -least;
}

#endif
