/* soft_limits.h - soft position limits, and the speed limit near them (FEATURE_POSITION_LIMITS).
 *
 * Extension of the reference design. A limit never causes motion: if the shaft is already beyond it, only further
 * motion in that direction is blocked.
 */
#ifndef SERVO_DRIVE_SOFT_LIMITS_H
#define SERVO_DRIVE_SOFT_LIMITS_H

#include "drive/axis_data.h"

typedef struct {
    frac32_t min; /* lowest permitted speed, Q1.31 of full-scale speed */
    frac32_t max; /* highest permitted speed, Q1.31 of full-scale speed */
} speed_range_t;

/* Path limits from limits and omega_n Ts of the path filter. */
path_limits_t soft_limits_path(const axis_config_t *config, const axis_limits_t *limits, uint16_t omega_n_ts);

/* Permitted speeds at the present position: within the speed limit, and slow enough to stop at a soft limit. */
speed_range_t soft_limits_speed(const axis_t *axis);

/* `speed`, limited to the permitted speed in its direction. */
frac32_t soft_limits_confined(const axis_t *axis, frac32_t speed);

/* True if a soft limit is set. */
static inline bool soft_limits_given(const axis_t *axis)
{
    return axis->limits.position_min != INT32_MIN || axis->limits.position_max != INT32_MAX;
}

/* `target`, limited to the soft limits. */
int32_t soft_limits_inside(const axis_t *axis, int32_t target);

/* Target of the motion, limited to the soft limits, or to the stopping position of the path if that is beyond a
 * limit. */
int32_t soft_limits_target(const axis_t *axis);

#endif
