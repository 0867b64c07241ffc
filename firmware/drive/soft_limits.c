#include "drive/soft_limits.h"

#include "drive/path_units.h"
#include "math/divide.h"

#define ONE_OVER_E_Q16 24109       /* 1 / e, 16 fraction bits */
#define HALF_E_SQUARED_Q12 15133 /* e^2 / 2, 12 fraction bits */

/* Speed limit as a function of the distance d to a soft limit. Close to it v = k d with k = omega_n / e, an acceleration of
 * k v, which the path filter may also require at that speed (E40). Where this exceeds a, half of the acceleration limit,
 * the curve continues smoothly as a stop at constant acceleration: v = sqrt(2 a (d - a / (2 k^2))). The other half of the
 * acceleration limit is a reserve: for the shaft, which lags its speed set-point, and for a position controller that
 * takes over, which needs the distance of its lag. */
path_limits_t soft_limits_path(const axis_config_t *config, const axis_limits_t *limits, uint16_t omega_n_ts)
{
    const path_position_t acceleration = path_step_of(config, limits->acceleration);
    const int64_t constant = asr64(acceleration, 1) * HALF_E_SQUARED_Q12 << 20;
    return (path_limits_t){
        .step = path_step_of(config, limits->speed),
        .acceleration = acceleration,
        .braking_constant = i64_over_u16(i64_over_u16(constant, omega_n_ts), omega_n_ts),
        .omega_n_ts = omega_n_ts,
    };
}

static frac32_t approach_speed(const axis_t *axis, int64_t distance)
{
    const path_limits_t *limits = &axis->path_limits;
    if (distance <= 0) {
        return 0;
    }
    const int32_t k = (int32_t)limits->omega_n_ts * ONE_OVER_E_Q16; /* per slow tick, 32 fraction bits */
    const path_position_t near = asr64(distance * k, 32 - PATH_BITS);
    path_position_t step = (near < limits->step) ? near : limits->step;
    const path_position_t acceleration = asr64(limits->acceleration, 1);
    if (asr64(step * k, 32) > acceleration) {
        step = braking_speed(distance * (INT32_C(1) << PATH_BITS) - limits->braking_constant, acceleration, step);
    }
    return (step < limits->step) ? path_speed_of(axis->config, step) : axis->limits.speed;
}

speed_range_t soft_limits_speed(const axis_t *axis)
{
    speed_range_t range = {-axis->limits.speed, axis->limits.speed};
    if (soft_limits_given(axis)) {
        const int64_t here = axis->feedback.position;
        range.max = approach_speed(axis, axis->limits.position_max - here);
        range.min = -approach_speed(axis, here - axis->limits.position_min);
    }
    return range;
}

frac32_t soft_limits_confined(const axis_t *axis, frac32_t speed)
{
    const frac32_t within = f32_clip(speed, axis->limits.speed);
    if (within == 0 || !soft_limits_given(axis)) {
        return within;
    }
    const int64_t here = axis->feedback.position;
    return (within > 0) ? f32_clip(within, approach_speed(axis, axis->limits.position_max - here))
                        : f32_clip(within, approach_speed(axis, here - axis->limits.position_min));
}

/* `target`, or the end of the range if that is reached first on the shorter way from `here`: counts wrap. */
static int32_t confined(int32_t target, int32_t here, int32_t range_min, int32_t range_max)
{
    const int64_t there = (int64_t)here + i32_sub_wrap(target, here);
    if (there > range_max) {
        return range_max;
    }
    return (there < range_min) ? range_min : target;
}

int32_t soft_limits_inside(const axis_t *axis, int32_t target)
{
    return confined(target, axis->feedback.position, axis->limits.position_min, axis->limits.position_max);
}

int32_t soft_limits_target(const axis_t *axis)
{
    const axis_limits_t *limits = &axis->limits;
    const int32_t target = axis->motion.target;
    if (target <= limits->position_max && target >= limits->position_min) {
        return target;
    }
    const int32_t here = path_filter_stopping_position(&axis->motion.path, axis->path_limits.acceleration);
    const int32_t range_min = (limits->position_min < here) ? limits->position_min : here;
    const int32_t range_max = (limits->position_max > here) ? limits->position_max : here;
    return confined(target, here, range_min, range_max);
}
