/* start.c - start of the board (DRM 4.3). */
#include "port/mc56f84789/drivers.h"
#include "port/mc56f84789/port.h"

static void state_init(hal_t *hal, servo_t *servo)
{
    static const uint16_t pwm[HAL_AXES] = {PWMA_BASE, PWMB_BASE};
    static const uint16_t tmr[HAL_AXES] = {TMRA_BASE, TMRB_BASE};
    const adc_pair_t middle = {2048U, 2048U};
    hal->servo = servo;
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        port_axis_t *axis = &hal->axis[i];
        axis->pwm = pwm[i];
        axis->tmr = tmr[i];
        axis->pair = PHASE_PAIR_AB;
        axis->currents = middle;
        axis->others = 0;
        axis->behind = false;
        axis->armed = false;
        axis->arms = 0;
    }
    hal->bus = 0;
    hal->watchdog_reset = (REG_READ(hal, SIM_RSTAT) & (SIM_RSTAT_COP_LOR | SIM_RSTAT_COP_CPU)) != 0U;
    hal->losses = 0;
    hal->late = 0;
    hal->last = 0;
    hal->m2_runs = 0;
    hal->running = false;
    hal->monitoring = false;
}

/* Everything but the watchdog; outputs off. */
static bool peripherals_init(hal_t *hal)
{
    if (!clock_init(hal)) {
        return false;
    }
    sim_init(hal);
    pwm_init(hal); /* outputs off before a pin is assigned to a PWM */
    pins_init(hal);
    crossbar_init(hal);
    timers_init(hal);
    serial_init(hal);
    interrupts_init(hal);
    return adc_init(hal);
}

bool port_init(hal_t *hal, servo_t *servo, const servo_config_t *config)
{
    state_init(hal, servo);
    cop_stop(hal);
    if (!peripherals_init(hal)) {
        cop_start(hal);
        return false;
    }
    servo_init(servo, hal, config);
    pwm_run(hal);
    sequence_arm(hal);
    cop_start(hal);
    INTERRUPTS_ON(hal);
    return true;
}
