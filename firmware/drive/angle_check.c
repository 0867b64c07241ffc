#include "drive/angle_check.h"

#include "drive/axis_faults.h"
#include "drive/sensorless_estimate.h"

/* Without dead-time compensation the dead time would appear as an angle error. */
#define NEEDED (FEATURE_ANGLE_CHECK | FEATURE_DEAD_TIME)

void angle_check_start(axis_t *axis)
{
    axis->fast = LOOP_FAST;
    sensorless_estimate_stop(axis);
}

static uint32_t encoder_angle(const axis_t *axis) { return (uint32_t)(uint16_t)axis->feedback.theta_e << 16; }

/* At low back-EMF the PLL is set to the encoder angle. */
static void guide_pll(axis_t *axis, int32_t step)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    if (estimate->size < sensorless_estimate_emf_at(axis, axis->config->startup.minimum_speed)) {
        sensorless_estimate_set_angle(axis, encoder_angle(axis) + (uint32_t)step, step);
        pll_adapt(&estimate->pll, &axis->config->pll, estimate->size);
    }
    estimate->pll.backwards = estimate->pll.integral < 0;
}

/* At small current its direction is uncertain, and with it the voltage drop of the switches: then the whole drop counts
 * as uncertainty, not only its compensated remainder. */
static frac16_t floor_of(const axis_t *axis)
{
    const dq_t i = axis->current_loop.current;
    const bool certain = length_about(i.d, i.q) > 2 * (int32_t)axis->config->winding.current_min;
    return certain ? axis->config->emf_check.floor
                   : f16_add(axis->config->emf_check.floor, axis->config->winding.emf_floor);
}

void angle_check_step(axis_t *axis)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    const int32_t step = pll_step_of(&axis->config->pll, axis->feedback.speed);
    if ((axis->parameter.features & NEEDED) != NEEDED || !axis_observable(axis)) {
        axis->fast = LOOP_FAST;
        sensorless_estimate_stop(axis);
        return;
    }
    if (!estimate->runs) {
        axis->fast = LOOP_OBSERVED;
        sensorless_estimate_start(axis, encoder_angle(axis), step);
        estimate->locked = true;
        return;
    }
    sensorless_estimate_step(axis);
    back_emf_observer_set_speed(&estimate->observer, step);
    /* The observed back-EMF is the mean over the period after the sample of the angle: use the angle in the middle of
     * it. */
    const frac16_t middle = pll_upper(encoder_angle(axis) + (uint32_t)asr32(step, 1));
    const dq_t emf = park(estimate->emf, sin_cos(middle));
    const frac16_t expected = sensorless_estimate_emf_at(axis, axis->feedback.speed);
    estimate->mismatch = emf_check_deviates(&axis->config->emf_check, floor_of(axis),
                                            emf_check_deviation(emf, expected), expected, axis->current_loop.current.q);
    guide_pll(axis, step);
}

void angle_check_judge(axis_t *axis)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    if (!estimate->runs) {
        return;
    }
    sensorless_estimate_judge(axis);
    if (emf_check_confirmed(&estimate->check, estimate->mismatch, axis->config->emf_check.ticks_check)) {
        axis_raise(axis, FOUND(FINDING_OBSERVER_ANGLE_MISMATCH));
    }
}
