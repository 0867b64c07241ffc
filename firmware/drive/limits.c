#include "drive/limits.h"

#include "drive/path_units.h"
#include "drive/soft_limits.h"

/* E40 needs accelerations up to omega_n v / e: with less current, or a higher speed, the filter has to be slower. */
static uint16_t omega_n_ts_under(const axis_config_t *config, axis_limits_t limits)
{
    uint32_t omega = (uint32_t)config->path_omega_n_ts * (uint32_t)limits.i_q / (uint32_t)config->i_q_limit;
    if (limits.speed > config->speed_limit) {
        omega = omega * (uint32_t)(config->speed_limit >> 16) / (uint32_t)(limits.speed >> 16);
    }
    if (omega > config->path_omega_n_ts) {
        return config->path_omega_n_ts;
    }
    return (omega == 0U) ? 1U : (uint16_t)omega;
}

static bool same(const axis_limits_t *a, const axis_limits_t *b)
{
    return a->speed == b->speed && a->acceleration == b->acceleration && a->i_q == b->i_q &&
           a->position_min == b->position_min && a->position_max == b->position_max;
}

static frac16_t lesser(frac16_t a, frac16_t b) { return (a < b) ? a : b; }

frac16_t limits_vector(const axis_t *axis)
{
    const frac16_t own = axis->config->i_q_limit;
    return (axis->limits.i_q > own) ? axis->limits.i_q : own;
}

void limits_current(axis_t *axis)
{
    axis->current_max.vector = lesser(limits_vector(axis), axis->current_max.winding);
    axis->current_max.q = lesser(axis->limits.i_q, axis->current_max.winding);
}

static int32_t lower(int32_t a, int32_t b) { return (a < b) ? a : b; }
static int32_t higher(int32_t a, int32_t b) { return (a > b) ? a : b; }

axis_limits_t limits_at_switches(const axis_t *axis, axis_limits_t limits)
{
    const int32_t here = axis->feedback.position;
    if ((axis->inputs & INPUT_LIMIT_MIN) != 0U) {
        limits.position_min = higher(limits.position_min, here);
    }
    if ((axis->inputs & INPUT_LIMIT_MAX) != 0U) {
        limits.position_max = lower(limits.position_max, here);
    }
    return limits;
}

/* Put new limits into force. */
static void apply(axis_t *axis, const axis_limits_t *written)
{
    const axis_limits_t limits = limits_at_switches(axis, *written);
    if (same(&limits, &axis->limits)) {
        return; /* the usual case */
    }
    axis->limits = limits;
    axis->path_limits.step = path_step_of(axis->config, limits.speed);
    axis->path_limits.acceleration = path_step_of(axis->config, limits.acceleration);
    axis->path_limits.stale = true;
    limits_current(axis);
}

void limits_tighten(axis_t *axis)
{
    const axis_limits_t *written = &axis->written_limits;
    axis_limits_t limits = axis->limits;
    limits.speed = lower(limits.speed, written->speed);
    limits.i_q = (frac16_t)lower(limits.i_q, written->i_q);
    limits.position_min = higher(limits.position_min, written->position_min);
    limits.position_max = lower(limits.position_max, written->position_max);
    apply(axis, &limits);
    axis->limits_fresh = false;
}

void limits_renew(axis_t *axis) { apply(axis, &axis->written_limits); }

void limits_settle(axis_t *axis)
{
    axis->path_limits = soft_limits_path(axis->config, &axis->limits, omega_n_ts_under(axis->config, axis->limits));
}

void limits_retune(axis_t *axis)
{
    const uint16_t before = axis->path_limits.omega_n_ts;
    limits_settle(axis);
    if (axis->path_limits.omega_n_ts != before && axis->motion.motion == MOTION_POSITION) {
        path_filter_retune(&axis->motion.path, axis->motion.target, axis->path_limits.acceleration, before,
                           axis->path_limits.omega_n_ts);
    }
}
