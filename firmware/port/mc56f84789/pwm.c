/* pwm.c - two inverters on eFlexPWM A and B. */
#include "port/mc56f84789/drivers.h"

/* ---- set up ----------------------------------------------------------------------------------------------------- */

static void write_sm(hal_t *hal, uint16_t module, uint16_t sm, uint16_t reg, uint16_t value)
{
    REG_WRITE(hal, module + PWM_SM(sm) + reg, value);
}

static uint16_t read_sm(hal_t *hal, uint16_t module, uint16_t sm, uint16_t reg)
{
    return REG_READ(hal, module + PWM_SM(sm) + reg);
}

static void submodule_init(hal_t *hal, uint16_t module, uint16_t sm)
{
    write_sm(hal, module, sm, PWM_CTRL, SET_PWM_CTRL);
    write_sm(hal, module, sm, PWM_INIT, SET_PWM_INIT);
    write_sm(hal, module, sm, PWM_VAL0, SET_PWM_VAL0);
    write_sm(hal, module, sm, PWM_VAL1, SET_PWM_VAL1);
    write_sm(hal, module, sm, PWM_VAL2, WORD(-PWM_HALF_PERIOD / 2)); /* 50 %, as the states before RUN have it */
    write_sm(hal, module, sm, PWM_VAL3, WORD(PWM_HALF_PERIOD / 2));
    write_sm(hal, module, sm, PWM_VAL4, SET_PWM_VAL4);
    write_sm(hal, module, sm, PWM_VAL5, 0U);
    write_sm(hal, module, sm, PWM_FRCTRL, 0U); /* whole clocks */
    write_sm(hal, module, sm, PWM_OCTRL, SET_PWM_OCTRL);
    write_sm(hal, module, sm, PWM_INTEN, 0U);
    write_sm(hal, module, sm, PWM_TCTRL, 0U);
    write_sm(hal, module, sm, PWM_DISMAP0, SET_PWM_DISMAP0);
    write_sm(hal, module, sm, PWM_DISMAP1, SET_PWM_DISMAP1);
    write_sm(hal, module, sm, PWM_DTCNT0, SET_PWM_DTCNT);
    write_sm(hal, module, sm, PWM_DTCNT1, SET_PWM_DTCNT);
}

static void module_init(hal_t *hal, uint16_t module, uint16_t ctrl2_first, uint16_t ctrl2_others)
{
    REG_WRITE(hal, module + PWM_OUTEN, 0U);
    REG_WRITE(hal, module + PWM_MCTRL, 0U);
    for (uint16_t sm = 0; sm < PWM_SM_USED; sm++) {
        submodule_init(hal, module, sm);
        write_sm(hal, module, sm, PWM_CTRL2, (sm == 0U) ? ctrl2_first : ctrl2_others);
    }
    REG_WRITE(hal, module + PWM_DTSRCSEL, 0U);
    REG_WRITE(hal, module + PWM_MASK, 0U);
}

/* Buffers are loaded, FORCE takes the outputs' sources over, then the faults are armed. */
static void module_finish(hal_t *hal, uint16_t module)
{
    REG_WRITE(hal, module + PWM_MCTRL, PWM_MCTRL_LDOK(PWM_ALL));
    for (uint16_t sm = 0; sm < PWM_SM_USED; sm++) {
        write_sm(hal, module, sm, PWM_CTRL2, read_sm(hal, module, sm, PWM_CTRL2) | PWM_CTRL2_FORCE);
    }
    REG_WRITE(hal, module + PWM_FFILT0, SET_PWM_FFILT0);
    REG_WRITE(hal, module + PWM_FCTRL0, SET_PWM_FCTRL0_SILENT);
    REG_WRITE(hal, module + PWM_FSTS0, SET_PWM_FSTS0 | PWM_FSTS_FFLAG_MASK);
    REG_WRITE(hal, module + PWM_FCTRL0, SET_PWM_FCTRL0);
}

void pwm_init(hal_t *hal)
{
    module_init(hal, PWMA_BASE, SET_PWMA_SM0_CTRL2, SET_PWMA_SM12_CTRL2);
    write_sm(hal, PWMA_BASE, 0U, PWM_VAL0, SET_PWMA_SM0_VAL0);
    write_sm(hal, PWMA_BASE, 0U, PWM_VAL5, SET_PWMA_SM0_VAL5);
    write_sm(hal, PWMA_BASE, 1U, PWM_VAL5, SET_PWMA_SM1_VAL5);
    write_sm(hal, PWMA_BASE, 0U, PWM_TCTRL, SET_PWMA_SM0_TCTRL);
    module_init(hal, PWMB_BASE, SET_PWMB_SM0_CTRL2, SET_PWMB_SM12_CTRL2);
    module_finish(hal, PWMA_BASE);
    module_finish(hal, PWMB_BASE);
}

/* The follower first: the master's first VAL0 already finds it running. */
void pwm_run(hal_t *hal)
{
    REG_WRITE(hal, PWMB_BASE + PWM_MCTRL, PWM_MCTRL_RUN(PWM_ALL) | PWM_MCTRL_LDOK(PWM_ALL));
    REG_WRITE(hal, PWMA_BASE + PWM_MCTRL, PWM_MCTRL_RUN(PWM_ALL) | PWM_MCTRL_LDOK(PWM_ALL));
}

/* ---- hal/hal.h -------------------------------------------------------------------------------------------------- */

/* Half the clocks that the high side is on. */
static int16_t half_pulse(int16_t duty)
{
    return (int16_t)(((int32_t)duty * PWM_HALF_PERIOD + INT32_C(0x4000)) / INT32_C(0x8000));
}

/* Without a pulse the low side stays on. The shortest one would open it for the dead time, and a current out of the motor
 * would go into the bus meanwhile: windings that are shorted have to be so all the time. VAL3 still ends a pulse that is
 * under way when the values are loaded. */
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
    if ((mctrl & PWM_MCTRL_LDOK_MASK) != 0U) { /* not loaded yet, and locked until it is: take it back */
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

bool hal_break_active(hal_t *hal, uint16_t axis)
{
    const uint16_t fsts = REG_READ(hal, hal->axis[axis].pwm + PWM_FSTS0);
    return (fsts & (PWM_FSTS_FFLAG(FAULT_INPUT) | PWM_FSTS_FFPIN(FAULT_INPUT))) != 0U;
}

void hal_break_clear(hal_t *hal, uint16_t axis)
{
    const uint16_t module = hal->axis[axis].pwm;
    REG_WRITE(hal, module + PWM_FSTS0, SET_PWM_FSTS0 | PWM_FSTS_FFLAG(FAULT_INPUT));
    REG_WRITE(hal, module + PWM_FCTRL0, SET_PWM_FCTRL0);
}

/* The fourth submodule of PWMB has two outputs of its own: pulses that begin with the period, in the middle at first. */
static void monitor_start(hal_t *hal)
{
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_CTRL, SET_MONITOR_CTRL);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_INIT, SET_PWM_INIT);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_VAL0, 0U);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_VAL1, SET_PWM_VAL1);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_VAL2, SET_PWM_INIT);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_VAL3, 0U);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_VAL4, SET_PWM_INIT);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_VAL5, 0U);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_FRCTRL, 0U);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_OCTRL, 0U);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_INTEN, 0U);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_TCTRL, 0U);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_DISMAP0, SET_MONITOR_DISMAP); /* no fault of the drive blinds it */
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_DISMAP1, SET_MONITOR_DISMAP);
    write_sm(hal, PWMB_BASE, MONITOR_SM, PWM_CTRL2, SET_MONITOR_CTRL2);
    hal->axis[1].others = SET_MONITOR_OUTEN;
    REG_WRITE(hal, PWMB_BASE + PWM_OUTEN, REG_READ(hal, PWMB_BASE + PWM_OUTEN) | SET_MONITOR_OUTEN);
    hal->monitoring = true;
}

void hal_monitor(hal_t *hal, uint16_t channel, uint16_t value)
{
    if (!hal->monitoring) {
        monitor_start(hal);
    }
    const int16_t end = (int16_t)((int32_t)(((uint32_t)value * PWM_PERIOD) >> 16) - PWM_HALF_PERIOD);
    const uint16_t run = REG_READ(hal, PWMB_BASE + PWM_MCTRL) & PWM_MCTRL_RUN_MASK;
    write_sm(hal, PWMB_BASE, MONITOR_SM, (channel == 0U) ? PWM_VAL3 : PWM_VAL5, WORD(end));
    REG_WRITE(hal, PWMB_BASE + PWM_MCTRL, run | PWM_MCTRL_RUN(BIT(MONITOR_SM)) | PWM_MCTRL_LDOK(BIT(MONITOR_SM)));
}

/* ---- over-current: the outputs are off already, the flag stays until the application clears it ------------------ */

static void over_current(hal_t *hal, uint16_t axis)
{
    REG_WRITE(hal, hal->axis[axis].pwm + PWM_FCTRL0, SET_PWM_FCTRL0_SILENT);
    servo_break_isr(hal->servo, axis);
}

void port_break_1(hal_t *hal) { over_current(hal, 0U); }

void port_break_2(hal_t *hal) { over_current(hal, 1U); }
