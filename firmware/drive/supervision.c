#include "drive/supervision.h"

#include "drive/motion.h"

static uint16_t count_while(bool holds, uint16_t ticks) { return holds ? (uint16_t)(ticks + 1U) : 0U; }

void supervision_start(supervision_t *supervision) { *supervision = (supervision_t){0}; }

/* Braked by the full current, or beyond its limit, the shaft has to lose speed, or at least not to gain any: a wrong
 * encoder angle turns the torque round. */
static bool runs_away(axis_t *axis)
{
    supervision_t *s = &axis->supervision;
    /* Sums of two fractions fit without a sign. */
    const uint32_t speed = (uint32_t)f32_abs(axis->feedback.speed);
    const uint32_t margin = (uint32_t)axis->config->runaway_margin;
    const bool opposed =
        axis->motion.saturated && !axis->motion.held_back && ((axis->feedback.speed < 0) != (axis->current_ref.q < 0));
    const bool beyond = speed > (uint32_t)axis->limits.speed + margin;
    if (!(opposed || beyond) || speed < s->braked_speed) {
        s->braked_speed = speed;
    }
    s->runaway_ticks = count_while(speed > s->braked_speed + margin, s->runaway_ticks);
    return s->runaway_ticks > axis->config->runaway_ticks_most;
}

/* The speed controller pushes with all it has, and nothing moves. */
static bool stalled(axis_t *axis)
{
    supervision_t *s = &axis->supervision;
    s->stall_ticks = count_while(axis->motion.saturated && axis->feedback.still, s->stall_ticks);
    return s->stall_ticks > axis->config->stall_ticks_most;
}

static bool off_path(axis_t *axis)
{
    supervision_t *s = &axis->supervision;
    const int32_t error = motion_following_error(axis);
    const int32_t most = axis->limits.following_error;
    const bool on = (axis->features & FEATURE_FOLLOWING_ERROR) != 0U;
    s->following_ticks = count_while(on && (error > most || error < -most), s->following_ticks);
    return s->following_ticks > axis->config->following_ticks_most;
}

static bool too_fast(axis_t *axis)
{
    supervision_t *s = &axis->supervision;
    const bool on = (axis->features & FEATURE_OVER_SPEED) != 0U;
    s->over_speed_ticks =
        count_while(on && f32_abs(axis->feedback.speed) > axis->limits.over_speed, s->over_speed_ticks);
    return s->over_speed_ticks > axis->config->over_speed_ticks_most;
}

fault_set_t supervision_step(axis_t *axis)
{
    fault_set_t faults = 0;
    if (runs_away(axis)) {
        faults |= FAULT_RUNAWAY;
    }
    if (stalled(axis)) {
        faults |= FAULT_STALLED;
    }
    if ((axis->features & (FEATURE_FOLLOWING_ERROR | FEATURE_OVER_SPEED)) == 0U) {
        axis->supervision.following_ticks = 0;
        axis->supervision.over_speed_ticks = 0;
        return faults;
    }
    if (off_path(axis)) {
        faults |= FAULT_FOLLOWING_ERROR;
    }
    if (too_fast(axis)) {
        faults |= FAULT_OVER_SPEED;
    }
    return faults;
}
