/* pwm.c - two inverters on eFlexPWM A and B, and the monitor outputs: what runs in every period. */
#include "port/mc56f84789/drivers.h"

/* ---- hal/hal.h -------------------------------------------------------------------------------------------------- */

/* Half the clocks that the high side is on. */
static int16_t half_pulse(int16_t duty)
{
    return (int16_t)(((int32_t)duty * PWM_HALF_PERIOD + INT32_C(0x4000)) / INT32_C(0x8000));
}

/* Without a pulse the low side stays on. The shortest pulse would switch it off for the dead time, and a current out of
 * the motor would flow into the bus meanwhile: shorted windings must be shorted all the time. VAL3 still ends a pulse
 * in progress when the values are loaded. */
static void write_pulse(hal_t *hal, uint16_t submodule, int16_t half)
{
    if (half < HALF_PULSE_MIN_CLOCKS) {
        REG_WRITE(hal, submodule + PWM_VAL2, SET_PWM_NEVER);
        REG_WRITE(hal, submodule + PWM_VAL3, WORD(HALF_PULSE_MIN_CLOCKS));
    } else {
        REG_WRITE(hal, submodule + PWM_VAL2, WORD(-half));
        REG_WRITE(hal, submodule + PWM_VAL3, WORD(half));
    }
}

void hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c)
{
    const uint16_t module = hal->axis[axis].pwm;
    const uint16_t mctrl = REG_READ(hal, module + PWM_MCTRL);
    const uint16_t run = mctrl & PWM_MCTRL_RUN_MASK;
    if ((mctrl & PWM_MCTRL_LDOK_MASK) != 0U) { /* not loaded yet, and locked until then: cancel the load */
        REG_WRITE(hal, module + PWM_MCTRL, run | PWM_MCTRL_CLDOK(PWM_ALL));
    }
    write_pulse(hal, module + PWM_SM(0U), half_pulse(duty_a));
    write_pulse(hal, module + PWM_SM(1U), half_pulse(duty_b));
    write_pulse(hal, module + PWM_SM(2U), half_pulse(duty_c));
    REG_WRITE(hal, module + PWM_MCTRL, run | PWM_MCTRL_LDOK(PWM_ALL));
    hal->axis[axis].behind = (REG_READ(hal, module + PWM_SM(1U) + PWM_CNT) & BIT(15)) == 0U;
}

/* OUTEN acts at once, MASK would wait for a FORCE. */
void hal_pwm_enable(hal_t *hal, uint16_t axis, bool on)
{
    REG_WRITE(hal, hal->axis[axis].pwm + PWM_OUTEN, (on ? SET_PWM_OUTEN : 0U) | hal->axis[axis].others);
}

bool hal_over_current_active(hal_t *hal, uint16_t axis)
{
    const uint16_t fsts = REG_READ(hal, hal->axis[axis].pwm + PWM_FSTS0);
    return (fsts & (PWM_FSTS_FFLAG(FAULT_INPUT) | PWM_FSTS_FFPIN(FAULT_INPUT))) != 0U;
}

void hal_over_current_clear(hal_t *hal, uint16_t axis)
{
    const uint16_t module = hal->axis[axis].pwm;
    REG_WRITE(hal, module + PWM_FSTS0, SET_PWM_FSTS0 | PWM_FSTS_FFLAG(FAULT_INPUT));
    REG_WRITE(hal, module + PWM_FCTRL0, SET_PWM_FCTRL0);
}

void hal_analog_out(hal_t *hal, uint16_t channel, uint16_t value)
{
    if (!hal->monitoring) {
        pwm_monitor_start(hal);
    }
    const int16_t end = (int16_t)((int32_t)(((uint32_t)value * PWM_PERIOD) >> 16) - PWM_HALF_PERIOD);
    const uint16_t run = REG_READ(hal, PWMB_BASE + PWM_MCTRL) & PWM_MCTRL_RUN_MASK;
    pwm_write(hal, PWMB_BASE, MONITOR_SM, (channel == 0U) ? PWM_VAL3 : PWM_VAL5, WORD(end));
    REG_WRITE(hal, PWMB_BASE + PWM_MCTRL, run | PWM_MCTRL_RUN(BIT(MONITOR_SM)) | PWM_MCTRL_LDOK(BIT(MONITOR_SM)));
}

/* ---- over-current: the hardware has switched the outputs off; the flag stays set until the application clears it  */

static void over_current(hal_t *hal, uint16_t axis)
{
    REG_WRITE(hal, hal->axis[axis].pwm + PWM_FCTRL0, SET_PWM_FCTRL0_SILENT);
    servo_over_current_isr(hal->servo, axis);
}

void port_break_1(hal_t *hal) { over_current(hal, 0U); }

void port_break_2(hal_t *hal) { over_current(hal, 1U); }
