#include "control/path.h"

#define ONE_COUNT (INT64_C(1) << PATH_BITS)

static path_position_t scaled(path_position_t x, uint16_t omega_n_ts)
{
    return asr64(x * omega_n_ts + INT64_C(0x8000), 16);
}

void path_reset(path_t *path, int32_t position, path_position_t step, uint16_t omega_n_ts)
{
    /* In steady motion y(k) - y(k-1) = omega_n Ts m and x(k) = y(k-1) + 2 m; the ramp kept here is x(k-1). */
    path->output = position * ONE_COUNT;
    path->filter = step * 65536 / omega_n_ts;
    path->ramp = path->output + 2 * path->filter - step;
}

void path_retune(path_t *path, int32_t target, uint16_t from_omega_n_ts, uint16_t to_omega_n_ts)
{
    const path_position_t end = target * ONE_COUNT;
    const path_position_t lead = (path->ramp - path->output) * from_omega_n_ts / to_omega_n_ts;
    const path_position_t ramp = path->output + lead;
    const bool passes = (lead > 0) ? (ramp > end) : (ramp < end);
    path->filter = path->filter * from_omega_n_ts / to_omega_n_ts;
    path->ramp = passes ? end : ramp;
}

void path_step(path_t *path, int32_t target, path_position_t step_limit, uint16_t omega_n_ts)
{
    const path_position_t distance = target * ONE_COUNT - path->ramp;
    if (distance > step_limit) {
        path->ramp += step_limit;
    } else if (distance < -step_limit) {
        path->ramp -= step_limit;
    } else {
        path->ramp += distance;
    }
    /* E40 */
    path->filter += scaled(path->ramp - 2 * path->filter - path->output, omega_n_ts);
    path->output += scaled(path->filter, omega_n_ts);
}

bool path_at_rest(const path_t *path, int32_t target)
{
    return path->ramp == target * ONE_COUNT && path_position(path) == target;
}

int32_t path_position(const path_t *path) { return (int32_t)asr64(path->output + ONE_COUNT / 2, PATH_BITS); }
