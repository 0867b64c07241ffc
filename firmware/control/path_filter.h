/* path_filter.h - shaping of position set-points: a ramp of limited speed and acceleration, then the second-order filter (DRM 2.6,
 * E38..E40).
 *
 * The impulse response of the filter is nowhere negative and has the area 1: speed and acceleration of the output stay
 * within the limits of the ramp, whatever the targets are.
 */
#ifndef SERVO_CONTROL_PATH_FILTER_H
#define SERVO_CONTROL_PATH_FILTER_H

#include "math/frac.h"

/* Positions in counts with 24 fraction bits. With 16 the filter would stop several counts short of its target. Counts
 * wrap at 32 bits, positions on a path do not: only whole counts may be compared, as path_beyond does. */
#define PATH_BITS 24
typedef int64_t path_position_t;

typedef struct {
    path_position_t ramp; /* x(k) */
    path_position_t speed; /* x(k) - x(k-1) */
    path_position_t filter; /* m(k) */
    path_position_t output; /* y(k) */
} path_filter_t;

/* Start at a position [counts] in steady motion with `step` [counts with 24 fraction bits per slow tick]; omega_n_ts is
 * omega_n Ts in Q0.16, not zero. */
void path_filter_reset(path_filter_t *path, int32_t position, path_position_t step, uint16_t omega_n_ts);

/* After path_filter_reset: as if the path had already been braking, if it could not stop at `target` from steady motion. */
void path_filter_start_braking(path_filter_t *path, int32_t target, path_position_t acceleration, uint16_t omega_n_ts);

/* Go on with another omega_n at the same position and speed; the lead of the ramp grows or shrinks with the filter's lag,
 * but the ramp stays where it can stop at `target`, and the output's acceleration within `acceleration`. */
void path_filter_retune(path_filter_t *path, int32_t target, path_position_t acceleration, uint16_t from_omega_n_ts,
                        uint16_t to_omega_n_ts);

/* One slow tick towards `target` [counts]. The speed of the ramp changes by at most `acceleration`, and comes down to
 * `step_limit` where it is above (both with 24 fraction bits, up to 16 and 160 counts). */
void path_filter_step(path_filter_t *path, int32_t target, path_position_t step_limit, path_position_t acceleration,
                      uint16_t omega_n_ts);

/* Where the ramp can stop [counts], rounded up as seen on its way. */
int32_t path_filter_stopping_position(const path_filter_t *path, path_position_t acceleration);

/* The highest speed up to `most` from which `distance` suffices to stop, the step at that speed included. */
path_position_t braking_speed(path_position_t distance, path_position_t acceleration, path_position_t max);

/* Counts as a position. */
static inline path_position_t path_counts(int32_t counts)
{
    return (path_position_t)counts * (INT32_C(1) << PATH_BITS);
}

/* Whole counts of a position, rounded down, wrapped as the encoder's position is. */
static inline int32_t path_whole(path_position_t x) { return (int32_t)(uint32_t)((uint64_t)x >> PATH_BITS); }

/* The rest. */
static inline int32_t path_part(path_position_t x)
{
    return (int32_t)((uint32_t)(uint64_t)x & ((UINT32_C(1) << PATH_BITS) - 1U));
}

/* How far a position is beyond `counts`, the short way round the wrap. */
static inline path_position_t path_beyond(path_position_t x, int32_t counts)
{
    return path_counts(i32_sub_wrap(path_whole(x), counts)) + path_part(x);
}

/* Output in whole counts, rounded. */
static inline int32_t path_filter_position(const path_filter_t *path)
{
    return path_whole(path->output + (INT32_C(1) << (PATH_BITS - 1)));
}

/* True when the output is within half a count of `target` and no longer on its way. */
static inline bool path_filter_at_rest(const path_filter_t *path, int32_t target)
{
    return path_filter_position(path) == target && path->speed == 0 && path_beyond(path->ramp, target) == 0;
}

#endif
