#include "drive/stop.h"

#include "drive/holding_brake.h"
#include "drive/motion.h"

void stop_begin(axis_t *axis, stop_category_t category)
{
    if (axis->enable_requested) {
        axis->enable_requested = false;
        axis->stop = (stop_t){.category = category};
    } else if (category < axis->stop.category) {
        axis->stop.category = category;
    }
}

stop_category_t stop_for(const stop_config_t *config, fault_set_t faults)
{
    if ((faults & ~(config->shorted | config->ramp | config->hold)) != 0U) {
        return STOP_CATEGORY_COAST;
    }
    const stop_category_t controlled = ((faults & config->ramp) != 0U) ? STOP_CATEGORY_RAMP : STOP_CATEGORY_HOLD;
    return ((faults & config->shorted) != 0U) ? STOP_CATEGORY_SHORT : controlled;
}

bool stop_is_controllable(const axis_t *axis)
{
    return axis->sm.state == STATE_RUN && (axis->substate == SUBSTATE_SPIN || axis->shorted);
}

bool stop_may_short(const axis_t *axis) { return f32_abs(axis->feedback.speed) <= axis->config->stop.short_speed; }

static bool out_of_time(axis_t *axis)
{
    stop_t *stop = &axis->stop;
    stop->ticks = (stop->ticks < UINT16_MAX) ? (uint16_t)(stop->ticks + 1U) : UINT16_MAX;
    return stop->ticks > axis->config->stop.ticks_max;
}

static bool held_long_enough(axis_t *axis)
{
    if (axis->motion.motion == MOTION_STOP) {
        return false; /* not at rest yet */
    }
    axis->stop.rest_ticks++;
    return axis->stop.rest_ticks > axis->config->stop.hold_ticks;
}

/* Hold the position until the holding brake has closed. Without position hold the brake closes as it is. */
static bool handed_to_brake(axis_t *axis, bool long_enough)
{
    if (axis->motion.motion != MOTION_STOP && long_enough) {
        holding_brake_request(axis, false);
    }
    return axis->motion.motion != MOTION_STOP && !axis->brake.open_requested && holding_brake_is_closed(axis);
}

static bool over(axis_t *axis, stop_category_t category)
{
    const bool long_enough = category == STOP_CATEGORY_HOLD && held_long_enough(axis);
    if (motion_stopped(axis)) {
        return true;
    }
    return holding_brake_takes_over(axis) ? handed_to_brake(axis, long_enough || category == STOP_CATEGORY_RAMP)
                                          : long_enough;
}

stop_category_t stop_step(axis_t *axis)
{
    const stop_category_t category = axis->stop.category;
    if (category == STOP_CATEGORY_COAST || (category == STOP_CATEGORY_SHORT && !stop_may_short(axis))) {
        return STOP_CATEGORY_COAST;
    }
    if (category == STOP_CATEGORY_SHORT) {
        return STOP_CATEGORY_SHORT;
    }
    return (out_of_time(axis) || over(axis, category)) ? STOP_CATEGORY_COAST : category;
}

bool stop_short_over(axis_t *axis) { return out_of_time(axis) || axis->feedback.still; }

bool stop_short_overloaded(const axis_t *axis)
{
    const int32_t d = axis->current_loop.current.d;
    const int32_t q = axis->current_loop.current.q;
    const int32_t max = axis->config->stop.short_current;
    return (uint32_t)(d * d) + (uint32_t)(q * q) > (uint32_t)(max * max);
}
