/* path.h - shaping of position set-points: speed-limited ramp, then the second-order filter (DRM 2.6, E38..E40). */
#ifndef SERVO_CONTROL_PATH_H
#define SERVO_CONTROL_PATH_H

#include "math/frac.h"

/* Positions in counts with 24 fraction bits. With 16 the filter would stop several counts short of its target. */
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

/* Output in whole counts, rounded. */
static inline int32_t path_position(const path_t *path)
{
    return (int32_t)asr64(path->output + (INT32_C(1) << (PATH_BITS - 1)), PATH_BITS);
}

/* True when the output is within half a count of `target` and no longer on its way. */
static inline bool path_at_rest(const path_t *path, int32_t target)
{
    return path_position(path) == target && path->ramp == path_counts(target);
}

#endif
