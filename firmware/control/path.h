/* path.h - shaping of position set-points: speed-limited ramp, then the second-order filter (DRM 2.6, E38..E40). */
#ifndef SERVO_CONTROL_PATH_H
#define SERVO_CONTROL_PATH_H

#include "math/frac.h"

/* Positions in counts with 24 fraction bits. With 16 the filter would stop several counts short of its target. Counts
 * wrap at 32 bits, positions on a path do not: only whole counts may be compared, as path_beyond does. */
#define PATH_BITS 24
typedef int64_t path_position_t;

typedef struct {
    path_position_t ramp;   /* x(k) */
    path_position_t filter; /* m(k) */
    path_position_t output; /* y(k) */
} path_t;

/* Start at a position [counts] in steady motion with `step` [counts with 24 fraction bits per slow tick]; omega_n_ts is
 * omega_n Ts in Q0.16, not zero. */
void path_reset(path_t *path, int32_t position, path_position_t step, uint16_t omega_n_ts);

/* Go on with another omega_n at the same position and speed; the lead of the ramp grows or shrinks with the filter's lag,
 * but not past `target`. */
void path_retune(path_t *path, int32_t target, uint16_t from_omega_n_ts, uint16_t to_omega_n_ts);

/* One slow tick towards `target` [counts], the ramp moving at most `step_limit` (24 fraction bits). */
void path_step(path_t *path, int32_t target, path_position_t step_limit, uint16_t omega_n_ts);

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
static inline int32_t path_position(const path_t *path)
{
    return path_whole(path->output + (INT32_C(1) << (PATH_BITS - 1)));
}

/* True when the output is within half a count of `target` and no longer on its way. */
static inline bool path_at_rest(const path_t *path, int32_t target)
{
    return path_position(path) == target && path_beyond(path->ramp, target) == 0;
}

#endif
