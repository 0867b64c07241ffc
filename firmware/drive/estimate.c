#include "drive/estimate.h"

void estimate_start(axis_t *axis, uint32_t angle, int32_t step)
{
    estimate_t *estimate = &axis->estimate;
    observer_reset(&estimate->observer, &axis->config->observer, (ab_t){0, 0});
    estimate_forget(axis);
    estimate->emf = (ab_t){0, 0};
    estimate->size = 0;
    estimate->turned = 0;
    estimate->standing = 0;
    estimate->angle = angle;
    axis->observed_position.angle = angle;
    estimate->expected = 0;
    estimate->deviation = (dq_t){0, 0};
    estimate->deviates = true;
    estimate->locked = false;
    estimate->runs = true;
    estimate_set(axis, angle, step);
}

void estimate_forget(axis_t *axis)
{
    estimate_t *estimate = &axis->estimate;
    speed_reliability_reset(&estimate->reliability);
    emf_check_reset(&estimate->check);
    estimate->mismatch = false;
    estimate->reliable = false;
}

void estimate_stop(axis_t *axis)
{
    axis->estimate.runs = false;
    axis->estimate.speed = 0;
    axis->estimate.size = 0;
}

void estimate_set(axis_t *axis, uint32_t angle, int32_t step)
{
    pll_reset(&axis->estimate.pll, angle, step);
    axis->estimate.speed = pll_speed_of(&axis->config->pll, step);
}

frac16_t estimate_emf_at(const axis_t *axis, frac32_t speed)
{
    return f16_from_f32(f32_gain(speed, axis->config->current_loop.omega_psi));
}

static frac16_t length(dq_t x) { return f16_sqrt(f32_add(f32_mul16(x.d, x.d), f32_mul16(x.q, x.q))); }

void estimate_turn(axis_t *axis)
{
    estimate_t *estimate = &axis->estimate;
    estimate->turned = (int32_t)(estimate->pll.angle - estimate->angle);
    estimate->angle = estimate->pll.angle;
}

void estimate_step(axis_t *axis)
{
    estimate_t *estimate = &axis->estimate;
    pll_t *pll = &estimate->pll;
    estimate->emf = observer_emf(&estimate->observer, &axis->config->observer);
    const dq_t emf = park(estimate->emf, sin_cos(pll_theta_of_emf(pll)));
    estimate->size = length(emf);
    estimate->speed = pll_speed_of(&axis->config->pll, pll->integral);
    pll_adapt(pll, &axis->config->pll, estimate->size);
    estimate->expected = estimate_emf_at(axis, estimate->speed);
    estimate->deviation = emf_check_deviation(emf, estimate->expected);
}

void estimate_judge(axis_t *axis)
{
    estimate_t *estimate = &axis->estimate;
    const speed_reliability_config_t *config = &axis->config->reliability;
    speed_reliability_add(&estimate->reliability, config, estimate->speed);
    const dq_t smooth = emf_check_filter(&estimate->check, estimate->deviation);
    estimate->deviates = emf_check_deviates(&axis->config->emf_check, axis->config->emf_check.floor_spin, smooth,
                                            estimate->expected, axis->current_loop.current.q);
    const frac32_t mean = f32_abs(speed_reliability_mean(&estimate->reliability));
    estimate->reliable = !estimate->deviates && mean >= axis->config->startup.minimum_speed &&
                         speed_reliability_holds(&estimate->reliability, config);
}

uint16_t estimate_standing(axis_t *axis)
{
    estimate_t *estimate = &axis->estimate;
    const frac32_t ahead = estimate->started_reverse ? -estimate->speed : estimate->speed;
    const bool slow = ahead < axis->config->startup.minimum_speed / 2;
    estimate->standing = slow ? (uint16_t)(estimate->standing + 1U) : 0U;
    return estimate->standing;
}
