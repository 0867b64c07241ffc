/* pwm_start.c - eFlexPWM A and B set up, and started. */
#include "port/mc56f84789/drivers.h"

static void submodule_init(hal_t *hal, uint16_t module, uint16_t sm)
{
    pwm_write(hal, module, sm, PWM_CTRL, SET_PWM_CTRL);
    pwm_write(hal, module, sm, PWM_INIT, SET_PWM_INIT);
    pwm_write(hal, module, sm, PWM_VAL0, SET_PWM_VAL0);
    pwm_write(hal, module, sm, PWM_VAL1, SET_PWM_VAL1);
    pwm_write(hal, module, sm, PWM_VAL2, WORD(-PWM_HALF_PERIOD / 2)); /* 50 %, as in the states before RUN */
    pwm_write(hal, module, sm, PWM_VAL3, WORD(PWM_HALF_PERIOD / 2));
    pwm_write(hal, module, sm, PWM_VAL4, SET_PWM_VAL4);
    pwm_write(hal, module, sm, PWM_VAL5, 0U);
    pwm_write(hal, module, sm, PWM_FRCTRL, 0U); /* whole clocks */
    pwm_write(hal, module, sm, PWM_OCTRL, SET_PWM_OCTRL);
    pwm_write(hal, module, sm, PWM_INTEN, 0U);
    pwm_write(hal, module, sm, PWM_TCTRL, 0U);
    pwm_write(hal, module, sm, PWM_DISMAP0, SET_PWM_DISMAP0);
    pwm_write(hal, module, sm, PWM_DISMAP1, SET_PWM_DISMAP1);
    pwm_write(hal, module, sm, PWM_DTCNT0, SET_PWM_DTCNT);
    pwm_write(hal, module, sm, PWM_DTCNT1, SET_PWM_DTCNT);
}

static void module_init(hal_t *hal, uint16_t module, uint16_t ctrl2_first, uint16_t ctrl2_others)
{
    REG_WRITE(hal, module + PWM_OUTEN, 0U);
    REG_WRITE(hal, module + PWM_MCTRL, 0U);
    for (uint16_t sm = 0; sm < PWM_SM_USED; sm++) {
        submodule_init(hal, module, sm);
        pwm_write(hal, module, sm, PWM_CTRL2, (sm == 0U) ? ctrl2_first : ctrl2_others);
    }
    REG_WRITE(hal, module + PWM_DTSRCSEL, 0U);
    REG_WRITE(hal, module + PWM_MASK, 0U);
}

/* Load the buffers, switch the sources of the outputs with FORCE, then arm the faults. */
static void module_finish(hal_t *hal, uint16_t module)
{
    REG_WRITE(hal, module + PWM_MCTRL, PWM_MCTRL_LDOK(PWM_ALL));
    for (uint16_t sm = 0; sm < PWM_SM_USED; sm++) {
        pwm_write(hal, module, sm, PWM_CTRL2, pwm_read(hal, module, sm, PWM_CTRL2) | PWM_CTRL2_FORCE);
    }
    REG_WRITE(hal, module + PWM_FFILT0, SET_PWM_FFILT0);
    REG_WRITE(hal, module + PWM_FCTRL0, SET_PWM_FCTRL0_SILENT);
    REG_WRITE(hal, module + PWM_FSTS0, SET_PWM_FSTS0 | PWM_FSTS_FFLAG_MASK);
    REG_WRITE(hal, module + PWM_FCTRL0, SET_PWM_FCTRL0);
}

void pwm_init(hal_t *hal)
{
    module_init(hal, PWMA_BASE, SET_PWMA_SM0_CTRL2, SET_PWMA_SM12_CTRL2);
    pwm_write(hal, PWMA_BASE, 0U, PWM_VAL0, SET_PWMA_SM0_VAL0);
    pwm_write(hal, PWMA_BASE, 0U, PWM_VAL5, SET_PWMA_SM0_VAL5);
    pwm_write(hal, PWMA_BASE, 1U, PWM_VAL5, SET_PWMA_SM1_VAL5);
    pwm_write(hal, PWMA_BASE, 0U, PWM_TCTRL, SET_PWMA_SM0_TCTRL);
    module_init(hal, PWMB_BASE, SET_PWMB_SM0_CTRL2, SET_PWMB_SM12_CTRL2);
    module_finish(hal, PWMA_BASE);
    module_finish(hal, PWMB_BASE);
}

/* The fault flag keeps the outputs off, like that of the over-current. It is cleared here; an open input sets it
 * again. */
void hal_enable_input(hal_t *hal, uint16_t axis, bool used)
{
    const uint16_t module = hal->axis[axis].pwm;
    for (uint16_t sm = 0; sm < PWM_SM_USED; sm++) {
        pwm_write(hal, module, sm, PWM_DISMAP0, used ? SET_PWM_DISMAP0_ENABLE : SET_PWM_DISMAP0);
    }
    REG_WRITE(hal, module + PWM_FSTS0, SET_PWM_FSTS0 | PWM_FSTS_FFLAG(ENABLE_INPUT));
}

/* Start the follower first, so that it runs before the first VAL0 of the master. */
void pwm_run(hal_t *hal)
{
    REG_WRITE(hal, PWMB_BASE + PWM_MCTRL, PWM_MCTRL_RUN(PWM_ALL) | PWM_MCTRL_LDOK(PWM_ALL));
    REG_WRITE(hal, PWMA_BASE + PWM_MCTRL, PWM_MCTRL_RUN(PWM_ALL) | PWM_MCTRL_LDOK(PWM_ALL));
}

/* The fourth submodule of PWMB has two outputs of its own: pulses that begin with the period, initially at half
 * scale. */
void pwm_monitor_start(hal_t *hal)
{
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_CTRL, SET_MONITOR_CTRL);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_INIT, SET_PWM_INIT);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_VAL0, 0U);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_VAL1, SET_PWM_VAL1);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_VAL2, SET_PWM_INIT);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_VAL3, 0U);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_VAL4, SET_PWM_INIT);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_VAL5, 0U);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_FRCTRL, 0U);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_OCTRL, 0U);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_INTEN, 0U);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_TCTRL, 0U);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_DISMAP0, SET_MONITOR_DISMAP); /* not switched off by faults */
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_DISMAP1, SET_MONITOR_DISMAP);
    pwm_write(hal, PWMB_BASE, MONITOR_SM, PWM_CTRL2, SET_MONITOR_CTRL2);
    hal->axis[1].others = SET_MONITOR_OUTEN;
    REG_WRITE(hal, PWMB_BASE + PWM_OUTEN, REG_READ(hal, PWMB_BASE + PWM_OUTEN) | SET_MONITOR_OUTEN);
    hal->monitoring = true;
}
