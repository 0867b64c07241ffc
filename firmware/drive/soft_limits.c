#include "drive/soft_limits.h"

#include "drive/path_units.h"

#define ONE_OVER_E_Q16 24109        /* 1 / e, 16 fraction bits */

/* Speed towards a limit that is so many counts away. It falls with the distance, which asks for the acceleration
 * (omega_n / e) v: what the path filter may ask for at the same speed (E40). */
static frac32_t approach_speed(const axis_t *axis, int64_t distance)
{
    if (distance <= 0) {
        return 0;
    }
    const path_position_t step = asr64(distance * axis->path_omega_n_ts * ONE_OVER_E_Q16, 32 - PATH_BITS);
    const path_position_t most = path_step_of(axis->config, axis->limits.speed);
    return (step < most) ? path_speed_of(axis->config, step) : axis->limits.speed;
}

speed_range_t soft_limits_speed(const axis_t *axis)
{
    speed_range_t range = {-axis->limits.speed, axis->limits.speed};
    if ((axis->features & FEATURE_POSITION_LIMITS) != 0U) {
        const int64_t here = axis->feedback.position;
        range.most = approach_speed(axis, axis->limits.position_max - here);
        range.least = -approach_speed(axis, here - axis->limits.position_min);
    }
    return range;
}

int32_t soft_limits_target(const axis_t *axis, int32_t target, int32_t here)
{
    const int32_t most = (axis->limits.position_max > here) ? axis->limits.position_max : here;
    const int32_t least = (axis->limits.position_min < here) ? axis->limits.position_min : here;
    if (target > most) {
        return most;
    }
    return (target < least) ? least : target;
}
