#include "drive/feedback_fast.h"

#include "drive/axis_data.h"

void encoder_source_fast(axis_t *axis)
{
    axis->feedback.theta_e =
        encoder_theta_e(&axis->encoder.counter, &axis->config->encoder, hal_encoder_count(axis->hal, axis->index));
}

void observer_source_fast(axis_t *axis) { axis->feedback.theta_e = pll_theta(&axis->estimate.pll); }
