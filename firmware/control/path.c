#include "control/path.h"

#include "math/divide.h"

static path_position_t scaled(path_position_t x, uint16_t omega_n_ts)
{
    return asr64(x * omega_n_ts + INT64_C(0x8000), 16);
}

void path_reset(path_t *path, int32_t position, path_position_t step, uint16_t omega_n_ts)
{
    /* In steady motion y(k) - y(k-1) = omega_n Ts m and x(k) = y(k-1) + 2 m; the ramp kept here is x(k-1). */
    path->output = path_counts(position);
    path->filter = i64_over_u16(step * 65536, omega_n_ts);
    path->ramp = path->output + 2 * path->filter - step;
}

void path_retune(path_t *path, int32_t target, uint16_t from_omega_n_ts, uint16_t to_omega_n_ts)
{
    const path_position_t lead = i64_over_u16((path->ramp - path->output) * from_omega_n_ts, to_omega_n_ts);
    const path_position_t ramp = path->output + lead;
    /* Only a ramp that is on its way to the target can be drawn past it; one that is yet to turn round keeps its lead. */
    const path_position_t before = path_beyond(path->ramp, target);
    const path_position_t beyond = path_beyond(ramp, target);
    const bool passes = (lead > 0) ? (before <= 0 && beyond > 0) : (before >= 0 && beyond < 0);
    path->filter = i64_over_u16(path->filter * from_omega_n_ts, to_omega_n_ts);
    path->ramp = passes ? ramp - beyond : ramp;
}

void path_step(path_t *path, int32_t target, path_position_t step_limit, uint16_t omega_n_ts)
{
    const path_position_t distance = -path_beyond(path->ramp, target);
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
