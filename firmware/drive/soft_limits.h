/* soft_limits.h - where the shaft may go, and how fast it may still turn near the end of that (FEATURE_POSITION_LIMITS).
 *
 * Beyond the reference design. A limit never pulls: set behind the shaft, or behind another limit, it only forbids to go
 * on that way. Nothing moves before somebody asks for it.
 */
#ifndef SERVO_DRIVE_SOFT_LIMITS_H
#define SERVO_DRIVE_SOFT_LIMITS_H

#include "drive/axis.h"

typedef struct {
    frac32_t least;
    frac32_t most;
} speed_range_t;

/* Speeds that are allowed where the shaft is: within the speed limit, and slow enough to stop at a limit of the position. */
speed_range_t soft_limits_speed(const axis_t *axis);

/* `target`, or the limit that lies before it as seen from `here` [counts], whether the feature is on or not. */
int32_t soft_limits_target(const axis_t *axis, int32_t target, int32_t here);

#endif
