/* current_drive.h - one PWM period of the current control of an axis: measured currents to duties. */
#ifndef SERVO_DRIVE_CURRENT_DRIVE_H
#define SERVO_DRIVE_CURRENT_DRIVE_H

#include "drive/axis_data.h"

/* Current control with the d axis at `theta_e`. */
void drive_current(axis_t *axis, frac16_t theta_e);

/* drive_current with the back-EMF observer, which needs the true voltage: the bus ripple is always compensated. */
void drive_observed(axis_t *axis, frac16_t theta_e);

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

static inline abc_t drive_measured(const axis_t *axis)
{
    return current_sense_read(&axis->sense, hal_adc_currents(axis->hal, axis->index));
}

/* Bus voltage of this period, unfiltered, for the ripple compensation. */
static inline frac16_t drive_bus(const axis_t *axis) { return (frac16_t)asr32(axis->u_dc_now, 16); }

#endif
