/* end_stop.h - elastic end stops of a shaft: on each side a spring with a damper, which can only push.
 *
 * Their torque is constant over a step of the plant. It is that of the middle of the step, which conserves energy; stable up
 * to stiffness x step^2 = inertia.
 */
#ifndef PLANT_END_STOP_H
#define PLANT_END_STOP_H

#include "board.h"

typedef struct {
    double low, high; /* mechanical [rad] */
    double stiffness; /* [N m/rad]; 0: no end stops */
    double drag;      /* torque per speed in contact [N m s] */
    double load;      /* external torque, without the stops [N m] */
} end_stop_t;

/* `step` is the one over which the torque is constant [s]. */
static inline end_stop_t end_stop_of(const plant_axis_t *config, double step)
{
    return (end_stop_t){config->stop_min, config->stop_max, config->stop_stiffness,
                        config->stop_damping + 0.5 * step * config->stop_stiffness, config->load_torque};
}

/* Torque against positive motion, the external load included [N m]. */
static inline double end_stop_load(const end_stop_t *stop, double theta, double omega)
{
    const double deep = (theta > stop->high) ? theta - stop->high : (theta < stop->low) ? theta - stop->low : 0.0;
    const double torque = stop->stiffness * deep + stop->drag * omega;
    return stop->load + ((torque * deep > 0.0) ? torque : 0.0);
}

#endif
