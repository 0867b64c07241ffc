/* path_filter.h - shaping of position set-points: a ramp with limited speed and acceleration, then the second-order
 * filter (DRM 2.6, E38..E40).
 *
 * The impulse response of the filter is non-negative with area 1: speed and acceleration of the output do not exceed
 * the limits of the ramp.
 */
#ifndef SERVO_CONTROL_PATH_FILTER_H
#define SERVO_CONTROL_PATH_FILTER_H

#include "math/frac.h"

/* Positions in counts with 24 fraction bits: with 16 the filter would stop several counts before its target. Counts
 * wrap at 32 bits, these positions do not: compare with path_beyond. */
#define PATH_BITS 24
typedef int64_t path_position_t;

typedef struct {
    path_position_t ramp; /* x(k): position of the ramp, counts with 24 fraction bits */
    path_position_t speed; /* x(k) - x(k-1): speed of the ramp, counts with 24 fraction bits per slow tick */
    path_position_t filter; /* m(k): state of the filter, counts with 24 fraction bits */
    path_position_t output; /* y(k): position set-point, counts with 24 fraction bits */
} path_filter_t;

/* Initialise at a position [counts] with the constant speed `step` [counts with 24 fraction bits per slow tick];
 * `omega_n_ts` is omega_n Ts in Q0.16, not zero. */
void path_filter_reset(path_filter_t *path, int32_t position, path_position_t step, uint16_t omega_n_ts);

/* After path_filter_reset: if the ramp could not stop at `target`, start with a ramp that is already decelerating. */
void path_filter_start_braking(path_filter_t *path, int32_t target, path_position_t acceleration, uint16_t omega_n_ts);

/* Change omega_n without a step of position and speed. The lead of the ramp is adapted to the new lag of the filter;
 * the ramp can still stop at `target`, and the acceleration of the output stays below `acceleration`. */
void path_filter_retune(path_filter_t *path, int32_t target, path_position_t acceleration, uint16_t from_omega_n_ts,
                        uint16_t to_omega_n_ts);

/* One slow tick towards `target` [counts]. The speed of the ramp changes by at most `acceleration` and is reduced to
 * `step_limit` if higher (both with 24 fraction bits, up to 16 and 160 counts). */
void path_filter_step(path_filter_t *path, int32_t target, path_position_t step_limit, path_position_t acceleration,
                      uint16_t omega_n_ts);

/* Stopping position of the ramp [counts], rounded away from the start. */
int32_t path_filter_stopping_position(const path_filter_t *path, path_position_t acceleration);

/* Highest speed, at most `max`, from which the ramp can stop within `distance`, including the next step at that
 * speed. */
path_position_t braking_speed(path_position_t distance, path_position_t acceleration, path_position_t max);

/* Position of whole counts. */
static inline path_position_t path_counts(int32_t counts)
{
    return (path_position_t)counts * (INT32_C(1) << PATH_BITS);
}

/* Whole counts of a position, rounded down, modulo 2^32 as the encoder position. */
static inline int32_t path_whole(path_position_t x) { return (int32_t)(uint32_t)((uint64_t)x >> PATH_BITS); }

/* Fraction of a position below one count, 24 fraction bits. */
static inline int32_t path_part(path_position_t x)
{
    return (int32_t)((uint32_t)(uint64_t)x & ((UINT32_C(1) << PATH_BITS) - 1U));
}

/* Distance from `counts` to a position, modulo 2^32 counts. */
static inline path_position_t path_beyond(path_position_t x, int32_t counts)
{
    return path_counts(i32_sub_wrap(path_whole(x), counts)) + path_part(x);
}

/* Position set-point in whole counts, rounded. */
static inline int32_t path_filter_position(const path_filter_t *path)
{
    return path_whole(path->output + (INT32_C(1) << (PATH_BITS - 1)));
}

/* True if the output is within half a count of `target` and the ramp is at rest there. */
static inline bool path_filter_at_rest(const path_filter_t *path, int32_t target)
{
    return path_filter_position(path) == target && path->speed == 0 && path_beyond(path->ramp, target) == 0;
}

#endif
