#include "drive/winding_protection.h"

#include "drive/limits.h"

static void set_limit(axis_t *axis, frac16_t winding)
{
    axis->current_max.winding = winding;
    limits_current(axis);
}

void winding_protection_init(axis_t *axis)
{
    winding_model_init(&axis->diagnosis.winding, &axis->config->winding_model);
    set_limit(axis, FRAC16_MAX);
}

/* The end of the derating widens the limit: like a limit written by the host, it takes effect with the next
 * set-point. */
static bool may_release(const axis_t *axis) { return axis->sm.state != STATE_RUN || axis->command.age == 0U; }

void winding_protection_step(axis_t *axis)
{
    winding_model_t *model = &axis->diagnosis.winding;
    const winding_model_config_t *config = &axis->config->winding_model;
    const bool on = (axis->parameter.features & FEATURE_WINDING_MODEL) != 0U;
    const bool step = winding_model_add(model, axis->current_loop.current);
    if (step) {
        winding_model_step(model, config, on);
    }
    if (on && step) {
        set_limit(axis, winding_model_limit(model, config, limits_vector(axis)));
    } else if (!on && axis->current_max.winding != FRAC16_MAX && may_release(axis)) {
        set_limit(axis, FRAC16_MAX);
    }
}
