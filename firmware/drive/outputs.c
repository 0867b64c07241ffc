#include "drive/outputs.h"

#define DUTY_HALF INT16_C(16384)

static void equal_duties(axis_t *axis, bool outputs_on, frac16_t duty)
{
    axis->sense.duty = (abc_t){duty, duty, duty};
    axis->sense.current = (abc_t){0, 0, 0};
    hal_pwm_duty(axis->hal, axis->index, duty, duty, duty);
    hal_pwm_enable(axis->hal, axis->index, outputs_on);
    current_loop_reset(&axis->current_loop);
    axis->current_ref = (dq_t){0, 0};
    axis->weakening = (field_weakening_t){0};
    axis->motion.motion = MOTION_STOP;
    axis->motion.speed_ref = 0;
}

void axis_zero_voltage(axis_t *axis, bool outputs_on)
{
    equal_duties(axis, outputs_on, DUTY_HALF);
    axis->shorted = false;
}

void axis_short(axis_t *axis)
{
    equal_duties(axis, true, 0);
    axis->shorted = true;
}
