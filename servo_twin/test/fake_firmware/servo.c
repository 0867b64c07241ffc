#include "app/servo.h"

#include "ideal_chip.h"

static fake_call_t *note(servo_t *servo, int kind, uint16_t axis)
{
    fake_call_t *call = &servo->call[servo->calls % FAKE_CALLS];
    servo->calls++;
    call->time_ns = servo->hal->now_ns;
    call->kind = kind;
    call->axis = axis;
    return call;
}

static void fast(servo_t *servo, int kind, uint16_t axis)
{
    fake_call_t *call = note(servo, kind, axis);
    call->currents = hal_adc_currents(servo->hal, axis);
    call->offsets = hal_adc_offsets(servo->hal, (uint16_t)(1 - axis));
    call->bus = hal_adc_bus(servo->hal);
    const int16_t *duty = servo->duty[axis];
    hal_pwm_duty(servo->hal, axis, duty[0], duty[1], duty[2]);
    hal_pwm_enable(servo->hal, axis, servo->on[axis]);
    hal_watchdog_service(servo->hal);
}

void servo_init(servo_t *servo, hal_t *hal, const servo_config_t *config)
{
    (void)config;
    servo->hal = hal;
}

void servo_m1_isr(servo_t *servo) { fast(servo, CALL_M1, 0); }

void servo_m2_isr(servo_t *servo) { fast(servo, CALL_M2, 1); }

void servo_edge_isr(servo_t *servo, uint16_t axis)
{
    (void)note(servo, CALL_EDGE, axis);
    (void)hal_capture_take(servo->hal, axis, &servo->capture);
}

void servo_over_current_isr(servo_t *servo, uint16_t axis) { (void)note(servo, CALL_OVER_CURRENT, axis); }

void servo_background(servo_t *servo)
{
    if (servo->log_background) {
        (void)note(servo, CALL_BACKGROUND, 0);
    }
    if (servo->deaf) {
        return;
    }
    for (;;) {
        if (!servo->has_pending && !hal_serial_get(servo->hal, &servo->pending)) {
            return;
        }
        servo->has_pending = servo->echo && !hal_serial_put(servo->hal, servo->pending);
        if (servo->has_pending) {
            return;
        }
    }
}
