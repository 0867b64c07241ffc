/* driven_shaft.h - a shaft whose motion is given from outside, by another simulator that owns its inertia.
 *
 * The motion is a cubic from the present angle and speed to those at the end of the given time, and continues at the speed at the
 * end. For the plant it is a shaft of infinite inertia: no torque moves it, and its speed in each step is the mean of the motion.
 */
#ifndef PLANT_DRIVEN_SHAFT_H
#define PLANT_DRIVEN_SHAFT_H

#include <stdbool.h>

typedef struct {
    bool on;
    double time, duration; /* since the beginning of the motion; of the motion [s] */
    double theta; /* at its end [rad] */
    double omega; /* at its end [rad/s] */
    double theta_0, omega_0, half_accel,
        sixth_jerk; /* coefficients of the cubic [rad], [rad/s], [rad/s^2], [rad/s^3] */
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

#endif
