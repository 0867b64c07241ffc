#include "drive/feedback.h"

#include "drive/axis_data.h"
#include "drive/feedback_fast.h"
#include "drive/path_units.h"

#define ABRUPT_COUNTS UINT32_C(8) /* position counts per slow tick; see observation.h */
#define ABRUPT_COUNTS_MIN 2U /* encoder counts: a single one may be jitter */

/* Position 0 at the present count. */
static void start_position(axis_t *axis)
{
    axis->encoder.position = (encoder_position_t){0, 0, encoder_lines(&axis->config->encoder)};
    axis->feedback.position = 0;
    axis->feedback.part = 0;
    axis->feedback.count = axis->encoder.counter.integral;
}

static void follow_counter(axis_t *axis)
{
    feedback_t *feedback = &axis->feedback;
    encoder_position_t *position = &axis->encoder.position;
    const int32_t count = axis->encoder.counter.integral;
    encoder_position_add(position, &axis->config->encoder, (int16_t)i32_sub_wrap(count, feedback->count));
    feedback->count = count;
    feedback->position = position->whole;
    feedback->part = encoder_position_part(position, &axis->config->encoder);
}

/* Quantities that depend on the size of a count. */
static void take_lines(axis_t *axis, uint16_t lines)
{
    const uint32_t per_line = POSITION_PER_TURN / 4;
    const uint16_t abrupt = (uint16_t)((ABRUPT_COUNTS * lines + per_line / 2U) / per_line);
    axis->encoder.resolution = (int16_t)((per_line + lines - 1U) / lines);
    axis->encoder.observer.half_count = (int32_t)((per_line << (SPEED_OBSERVER_BITS - 1)) / lines);
    axis->observation.abrupt_counts = (abrupt > ABRUPT_COUNTS_MIN) ? abrupt : ABRUPT_COUNTS_MIN;
}

static void encoder_source_reset(axis_t *axis)
{
    take_lines(axis, encoder_lines(&axis->config->encoder));
    hal_encoder_start(axis->hal, axis->index, axis->config->encoder.counts);
    const uint16_t count = hal_encoder_count(axis->hal, axis->index);
    const uint16_t index = hal_index_count(axis->hal, axis->index);
    encoder_reset(&axis->encoder.counter, count, index);
    start_position(axis);
    mt_speed_reset(&axis->encoder.speed);
    axis->encoder.edge_waits = false;
    axis->encoder.skip_edge = false;
    axis->encoder.found = false;
    axis->aligned = false;
    axis->encoder.observes = false;
    hal_capture_arm(axis->hal, axis->index);
}

static void encoder_source_edge(axis_t *axis)
{
    edge_capture_t capture;
    if (hal_capture_take(axis->hal, axis->index, &capture)) {
        axis->encoder.edge = capture;
        axis->encoder.edge_waits = true;
    }
}

/* Speed for the controllers: M/T, or the speed observer, which is initialised with the M/T speed. */
static frac32_t speed_feedback(axis_t *axis)
{
    encoder_feedback_t *encoder = &axis->encoder;
    const speed_observer_config_t *config = &axis->config->speed_observer;
    const feedback_t *at = &axis->feedback;
    const bool observed = encoder->observes;
    encoder->observes = (axis->parameter.features & FEATURE_SPEED_OBSERVER) != 0U && axis_has_speed_observer(axis);
    if (!encoder->observes) {
        return encoder->speed.speed;
    }
    if (!observed) {
        speed_observer_reset(&encoder->observer, config, at->position, at->part, encoder->speed.speed);
        return encoder->speed.speed;
    }
    return speed_observer_step(&encoder->observer, config, at->position, at->part, axis->current_ref.q);
}

/* The observer needs the M/T speed only for its initialisation; the enhancement of M/T is not needed after that. */
static bool stretches(const axis_t *axis)
{
    const bool observes = axis->encoder.observes && (axis->parameter.features & FEATURE_SPEED_OBSERVER) != 0U;
    return (axis->parameter.features & FEATURE_ENHANCED_MT) != 0U && !observes;
}

static bool encoder_source_slow(axis_t *axis)
{
    /* Read before arming: clearing the flags would discard an edge whose interrupt is still pending. */
    encoder_source_edge(axis);
    if (axis->encoder.edge_waits) {
        axis->encoder.edge_waits = false;
        if (!axis->encoder.skip_edge) {
            mt_speed_edge(&axis->encoder.speed, &axis->config->mt_speed, &axis->config->encoder, axis->encoder.edge);
        }
        axis->encoder.skip_edge = false;
    }
    const uint32_t age = hal_edge_age(axis->hal, axis->index);
    mt_speed_slow(&axis->encoder.speed, age, stretches(axis));
    hal_capture_arm(axis->hal, axis->index);

    /* Read the count before the index: then every wrap of the count has its index pulse. */
    const uint16_t count = hal_encoder_count(axis->hal, axis->index);
    const uint16_t index = hal_index_count(axis->hal, axis->index);
    const bool consistent = encoder_update(&axis->encoder.counter, &axis->config->encoder, count, index);
    const int32_t before = axis->feedback.position;
    follow_counter(axis);
    const int32_t moved = i32_sub_wrap(axis->feedback.position, before);
    axis->feedback.speed = speed_feedback(axis);
    axis->feedback.mean_speed = sat32((int64_t)moved * axis->config->speed_per_path_step);
    axis->feedback.still = age >= HAL_EDGE_AGE_OVERFLOW;
    return consistent;
}

static void encoder_source_resync(axis_t *axis) { encoder_resync(&axis->encoder.counter, &axis->config->encoder); }

static void encoder_source_align(axis_t *axis, frac16_t theta_e)
{
    const uint16_t count = (uint16_t)encoder_count_at(&axis->config->encoder, theta_e);
    hal_encoder_preset(axis->hal, axis->index, count);
    if (axis->encoder.found) {
        encoder_preset(&axis->encoder.counter, &axis->config->encoder, count); /* keeps the turn count */
    } else {
        encoder_reset(&axis->encoder.counter, count, hal_index_count(axis->hal, axis->index));
        start_position(axis);
        axis->encoder.found = true;
    }
    /* The next captured count has no relation to the last one. */
    mt_speed_reset(&axis->encoder.speed);
    axis->encoder.edge_waits = false;
    axis->encoder.skip_edge = true;
    axis->encoder.observes = false;
    hal_capture_arm(axis->hal, axis->index);
}

const feedback_source_t encoder_feedback = {
    encoder_source_reset, encoder_source_fast,   encoder_source_slow,
    encoder_source_edge,  encoder_source_resync, encoder_source_align,
};
