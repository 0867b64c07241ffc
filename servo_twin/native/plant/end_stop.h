/* end_stop.h - elastic end stops of a shaft: a spring with a damper on each side, which only push.
 *
 * Their torque is worked out once per step of the plant and stands until the next one. It is that of the middle of the
 * step, which neither adds energy nor takes any: stable up to stiffness x step^2 = inertia.
 */
#ifndef PLANT_END_STOP_H
#define PLANT_END_STOP_H

#include "board.h"

typedef struct {
    double low, high; /* mechanical [rad] */
    double stiffness; /* [N m/rad]; 0: there are none */
    double drag;      /* torque per speed, in contact [N m s] */
    double load;      /* external, without the stops [N m] */
} end_stop_t;

static inline end_stop_t end_stop_of(const plant_axis_t *config, double step)
{
    return (end_stop_t){config->stop_min, config->stop_max, config->stop_stiffness,
                        config->stop_damping + 0.5 * step * config->stop_stiffness, config->load_torque};
}

/* Against positive motion, the external load included [N m]. */
static inline double end_stop_load(const end_stop_t *stop, double theta, double omega)
{
    const double deep = (theta > stop->high) ? theta - stop->high : (theta < stop->low) ? theta - stop->low : 0.0;
    const double torque = stop->stiffness * deep + stop->drag * omega;
    return stop->load + ((torque * deep > 0.0) ? torque : 0.0);
}

#endif
