/* feedback_observer.c - angle and speed of an axis without an encoder. */
#include "drive/feedback.h"
#include "drive/feedback_fast.h"
#include "drive/sensorless_estimate.h"

static void observer_source_reset(axis_t *axis)
{
    sensorless_estimate_stop(axis);
    axis->observed_position = (observer_feedback_t){.counts = axis->feedback.position};
    axis->feedback.part = 0;
    axis->feedback.speed = 0;
    axis->feedback.mean_speed = 0;
    axis->feedback.still = true;
}

/* Discards the captures of an encoder that is connected but not used, so that its interrupt does not repeat. */
static void observer_source_edge(axis_t *axis)
{
    edge_capture_t capture;
    (void)hal_capture_take(axis->hal, axis->index, &capture);
}

/* Angle in position counts, 16 fraction bits. */
static int32_t counts_of(const axis_t *axis, int32_t angle)
{
    return (int32_t)asr64((int64_t)angle * axis->config->pll.counts_per_turn, 32);
}

static bool observer_source_slow(axis_t *axis)
{
    feedback_t *feedback = &axis->feedback;
    feedback->still = !axis->estimate.runs;
    if (!axis->estimate.runs) {
        feedback->speed = 0;
        feedback->mean_speed = 0;
        return true;
    }
    const pll_t *pll = &axis->estimate.pll;
    observer_feedback_t *observed = &axis->observed_position;
    axis->estimate.speed = pll_speed_of(&axis->config->pll, pll->integral);
    const int32_t moved = counts_of(axis, (int32_t)(pll->angle - observed->angle));
    const uint32_t rest = (uint32_t)observed->rest + ((uint32_t)moved & UINT32_C(0xFFFF));
    observed->angle = pll->angle;
    observed->rest = (uint16_t)(rest & UINT32_C(0xFFFF));
    observed->counts = i32_add_wrap(observed->counts, asr32(moved, 16) + (int32_t)(rest >> 16));
    feedback->position = observed->counts;
    feedback->speed = axis->estimate.speed;
    feedback->mean_speed = sat32(asr64((int64_t)moved * axis->config->speed_per_path_step, 16));
    return true;
}

static void observer_source_resync(axis_t *axis) { (void)axis; }

const feedback_source_t observer_feedback = {
    observer_source_reset, observer_source_fast,   observer_source_slow,
    observer_source_edge,  observer_source_resync, 0, /* no rotor search */
};
