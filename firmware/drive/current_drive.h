/* current_drive.h - one PWM period of an axis: currents in, duties out. */
#ifndef SERVO_DRIVE_CURRENT_DRIVE_H
#define SERVO_DRIVE_CURRENT_DRIVE_H

#include "drive/axis.h"

static inline void drive_choose_pair(axis_t *axis, phase_pair_t pair)
{
    axis->sense.pair = pair;
    hal_adc_select(axis->hal, axis->index, pair);
}

static inline void drive_apply(axis_t *axis, svm_t out)
{
    hal_pwm_duty(axis->hal, axis->index, (frac16_t)out.duty.a, (frac16_t)out.duty.b, (frac16_t)out.duty.c);
    axis->sense.duty = out.duty;
    drive_choose_pair(axis, current_sense_pair(out.sector));
}

/* Voltage of the bus in this period. Unfiltered: it is the ripple that counts. */
static inline frac16_t drive_bus(const axis_t *axis) { return (frac16_t)asr32(axis->u_dc_now, 16); }

/* Current control with the d axis at `theta_e`. */
static inline void drive_current(axis_t *axis, frac16_t theta_e)
{
    const abc_t current = current_sense_read(&axis->sense, hal_adc_currents(axis->hal, axis->index));
    const frac16_t u_dc =
        ((axis->features & FEATURE_BUS_COMPENSATION) != 0U) ? drive_bus(axis) : axis->config->u_dc_nominal;
    drive_apply(axis, current_loop_step(&axis->current_loop, &axis->config->current_loop, current, axis->current_ref,
                                        theta_e, u_dc));
}

/* The same under the eyes of the observer, which has to know the true voltage: the ripple is always compensated. */
static inline void drive_observed(axis_t *axis, frac16_t theta_e)
{
    const abc_t current = current_sense_read(&axis->sense, hal_adc_currents(axis->hal, axis->index));
    const current_loop_out_t out = current_loop_run(&axis->current_loop, &axis->config->current_loop, current,
                                                    axis->current_ref, theta_e, drive_bus(axis));
    drive_apply(axis, out.svm);
    observer_step(&axis->estimate.observer, &axis->config->observer, out.current, out.voltage);
}

#endif
