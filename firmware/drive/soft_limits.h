/* soft_limits.h - where the shaft may go, and how fast it may still turn near the end of that (FEATURE_POSITION_LIMITS).
 *
 * Beyond the reference design. A limit never pulls: set behind the shaft, or behind another limit, it only forbids to go
 * on that way. Nothing moves before it is commanded.
 */
#ifndef SERVO_DRIVE_SOFT_LIMITS_H
#define SERVO_DRIVE_SOFT_LIMITS_H

#include "drive/axis_data.h"

typedef struct {
    frac32_t min; /* Q1.31 of full-scale speed */
    frac32_t max; /* the same */
} speed_range_t;

/* What follows from limits, with this omega_n Ts of the path filter. */
path_limits_t soft_limits_path(const axis_config_t *config, const axis_limits_t *limits, uint16_t omega_n_ts);

/* Speeds that are allowed where the shaft is: within the speed limit, and slow enough to stop at a limit of the position. */
speed_range_t soft_limits_speed(const axis_t *axis);

/* `speed`, or what is allowed of it that way. */
frac32_t soft_limits_confined(const axis_t *axis, frac32_t speed);

/* True if there is a soft limit. */
static inline bool soft_limits_given(const axis_t *axis)
{
    return axis->limits.position_min != INT32_MIN || axis->limits.position_max != INT32_MAX;
}

/* `target`, or the limit that it is beyond. */
int32_t soft_limits_inside(const axis_t *axis, int32_t target);

/* Target of the motion, or the limit that lies before it as seen from where the path can stop. */
int32_t soft_limits_target(const axis_t *axis);

#endif
