#include "drive/sensorless_estimate.h"

void sensorless_estimate_start(axis_t *axis, uint32_t angle, int32_t step)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    back_emf_observer_reset(&estimate->observer, &axis->config->observer, (ab_t){0, 0});
    sensorless_estimate_clear_checks(axis);
    estimate->emf = (ab_t){0, 0};
    estimate->size = 0;
    estimate->rotation = 0;
    estimate->standstill_ticks = 0;
    estimate->angle = angle;
    axis->observed_position.angle = angle;
    estimate->expected_emf = 0;
    estimate->deviation = (dq_t){0, 0};
    estimate->deviates = true;
    estimate->locked = false;
    estimate->runs = true;
    sensorless_estimate_set_angle(axis, angle, step);
}

void sensorless_estimate_clear_checks(axis_t *axis)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    speed_reliability_reset(&estimate->reliability);
    emf_check_reset(&estimate->check);
    estimate->mismatch = false;
    estimate->reliable = false;
}

void sensorless_estimate_stop(axis_t *axis)
{
    axis->estimate.runs = false;
    axis->estimate.speed = 0;
    axis->estimate.size = 0;
}

void sensorless_estimate_set_angle(axis_t *axis, uint32_t angle, int32_t step)
{
    pll_reset(&axis->estimate.pll, angle, step);
    axis->estimate.speed = pll_speed_of(&axis->config->pll, step);
}

frac16_t sensorless_estimate_emf_at(const axis_t *axis, frac32_t speed)
{
    return f16_from_f32(f32_gain(speed, axis->config->current_loop.omega_psi));
}

static frac16_t length(dq_t x) { return f16_sqrt(f32_add(f32_mul16(x.d, x.d), f32_mul16(x.q, x.q))); }

void sensorless_estimate_update_rotation(axis_t *axis)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    estimate->rotation = (int32_t)(estimate->pll.angle - estimate->angle);
    estimate->angle = estimate->pll.angle;
}

void sensorless_estimate_step(axis_t *axis)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    pll_t *pll = &estimate->pll;
    estimate->emf = back_emf_observer_emf(&estimate->observer, &axis->config->observer);
    const dq_t emf = park(estimate->emf, sin_cos(pll_theta_of_emf(pll)));
    estimate->size = length(emf);
    estimate->speed = pll_speed_of(&axis->config->pll, pll->integral);
    pll_adapt(pll, &axis->config->pll, estimate->size);
    estimate->expected_emf = sensorless_estimate_emf_at(axis, estimate->speed);
    estimate->deviation = emf_check_deviation(emf, estimate->expected_emf);
}

void sensorless_estimate_judge(axis_t *axis)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    const speed_reliability_config_t *config = &axis->config->reliability;
    speed_reliability_add(&estimate->reliability, config, estimate->speed);
    const dq_t smooth = emf_check_filter(&estimate->check, estimate->deviation);
    estimate->deviates = emf_check_deviates(&axis->config->emf_check, axis->config->emf_check.floor_spin, smooth,
                                            estimate->expected_emf, axis->current_loop.current.q);
    const frac32_t mean = f32_abs(speed_reliability_mean(&estimate->reliability));
    estimate->reliable = !estimate->deviates && mean >= axis->config->startup.minimum_speed &&
                         speed_reliability_holds(&estimate->reliability, config);
}

uint16_t sensorless_estimate_count_standstill(axis_t *axis)
{
    sensorless_estimate_t *estimate = &axis->estimate;
    const frac32_t ahead = estimate->started_reverse ? -estimate->speed : estimate->speed;
    const bool slow = ahead < axis->config->startup.minimum_speed / 2;
    estimate->standstill_ticks = slow ? (uint16_t)(estimate->standstill_ticks + 1U) : 0U;
    return estimate->standstill_ticks;
}
