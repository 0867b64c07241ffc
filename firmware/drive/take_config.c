#include "drive/take_config.h"

#include "drive/homing.h"
#include "drive/inputs.h"
#include "drive/limits.h"
#include "drive/ripple_forward.h"
#include "drive/speed_control.h"

bool axis_takes_any_config(const axis_t *axis)
{
    return axis->sm.state != STATE_RUN && f32_abs(axis->feedback.speed) <= axis->config->stop_speed;
}

/* Adjust the load estimates, so that the estimated net acceleration does not step with the new values. */
static void keep_estimates(axis_t *axis, const axis_config_t *config)
{
    const axis_config_t *before = axis->config;
    if (axis->encoder.observes) {
        speed_observer_retune(&axis->encoder.observer, &before->speed_observer, &config->speed_observer,
                              axis->current_ref.q);
    }
    if (axis->estimate.runs) {
        pll_retune(&axis->estimate.pll, &before->pll, &config->pll, axis->current_loop.current.q);
    }
}

void axis_take_config(axis_t *axis, const axis_config_t *config)
{
    if (axis->sm.state == STATE_RUN) {
        current_loop_retune(&axis->current_loop, &axis->config->current_loop, &config->current_loop, axis->current_ref);
        speed_control_retune(axis, config, 0);
        ripple_forward_retune(axis, config);
        axis->motion.forced = false;
        keep_estimates(axis, config);
    } else {
        axis->motion.position_gain = config->position_gain;
        axis->aligned = false;
    }
    const bool other_encoder =
        axis->sm.state != STATE_RUN && encoder_lines(&config->encoder) != encoder_lines(&axis->config->encoder);
    axis->config = config;
    if (axis->sm.state != STATE_RUN) { /* what follows depends on members that are not live */
        speed_control_start(axis);
        inputs_configure(axis);
        axis->diagnosis.bus.u_dc_max = config->u_dc_max;
        axis->diagnosis.bus.u_dc_min = config->u_dc_min;
        limits_current(axis);
        if (other_encoder) { /* another number of counts per turn: the position is not known any more */
            axis->source->reset(axis);
            homing_forget(axis);
        }
    }
    axis->path_limits.stale = true; /* the path filter */
}
