/* port.c - the cycle of the two fast loops (DRM 4.3). */
#include "port/mc56f84789/port.h"

#include "port/mc56f84789/drivers.h"

/* The loss counter decays by one per period: more than four losses in 16 ms are too many. */
#define LOSS 64U
#define LOSSES_MAX 256U

#define LOOPS 2U /* M1 and M2 */

/* ---- sequence --------------------------------------------------------------------------------------------------- */

/* Stop sampling and M1 of both motors; the next scan begins with the first pair. */
static void sequence_stop(hal_t *hal)
{
    REG_WRITE(hal, PWMA_BASE + PWM_SM(0U) + PWM_INTEN, 0U);
    REG_WRITE(hal, PWMA_BASE + PWM_SM(1U) + PWM_TCTRL, 0U);
    REG_WRITE(hal, PWMA_BASE + PWM_SM(1U) + PWM_INTEN, 0U);
    REG_WRITE(hal, PWMB_BASE + PWM_SM(0U) + PWM_TCTRL, 0U);
    adc_stop(hal);
}

/* The start interrupt lies between motor 2's sample and the end of motor 1's period: the next trigger is motor 1's. */
void sequence_arm(hal_t *hal)
{
    adc_arm(hal);
    REG_WRITE(hal, PWMA_BASE + PWM_SM(0U) + PWM_STS, PWM_STS_CMPF(START_VAL));
    REG_WRITE(hal, PWMA_BASE + PWM_SM(0U) + PWM_INTEN, PWM_INTEN_CMPIE(START_VAL));
}

/* Once, in the order of DRM 4.3.3. */
void port_start(hal_t *hal)
{
    REG_WRITE(hal, PWMA_BASE + PWM_SM(1U) + PWM_STS, PWM_STS_CMPF(M1_VAL));
    REG_WRITE(hal, PWMA_BASE + PWM_SM(1U) + PWM_TCTRL, SET_TCTRL_SAMPLE);
    REG_WRITE(hal, PWMA_BASE + PWM_SM(1U) + PWM_INTEN, PWM_INTEN_CMPIE(M1_VAL));
    REG_WRITE(hal, PWMB_BASE + PWM_SM(0U) + PWM_TCTRL, SET_TCTRL_SAMPLE);
    REG_WRITE(hal, PWMA_BASE + PWM_SM(0U) + PWM_STS, PWM_STS_CMPF(START_VAL));
    REG_WRITE(hal, PWMA_BASE + PWM_SM(0U) + PWM_INTEN, 0U);
}

/* After a lost trigger the duty cycles stay constant for one period while the scan restarts. After repeated losses the
 * outputs are switched off, and the watchdog, which only running loops serve, resets the board. */
static void sequence_lost(hal_t *hal)
{
    sequence_stop(hal);
    hal->losses = (uint16_t)(hal->losses + LOSS);
    if (hal->losses <= LOSSES_MAX) {
        sequence_arm(hal);
        return;
    }
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        hal_pwm_enable(hal, axis, false);
    }
}

/* ---- t1 and t3 -------------------------------------------------------------------------------------------------- */

static void scope(hal_t *hal, uint16_t pins) { REG_WRITE(hal, GPIO(GPIO_F) + GPIO_DR, pins); }

/* Pairs of loops omitted since the last M1, from the encoder's time stamps, which run independently of the core. The
 * application detects a single omitted loop. */
static void note_gap(hal_t *hal)
{
    const uint16_t now = REG_READ(hal, TMRA_BASE + TMR_CHANNEL(1U) + TMR_CNTR);
    const uint16_t gap = (uint16_t)(now - hal->last);
    hal->last = now;
    if (gap >= GAP_TIME_STAMPS && hal->running) {
        const uint16_t periods = (uint16_t)((gap * TIME_STAMP_DIVIDER + PWM_PERIOD / 2UL) / PWM_PERIOD);
        const uint16_t paired = (hal->m2_runs > 1U) ? hal->m2_runs : 1U; /* periods with an M2 */
        hal->late = (uint16_t)(hal->late + ((periods > paired) ? LOOPS * (periods - paired) : 0U));
    }
    hal->m2_runs = 0;
    hal->running = true;
}

/* New duty cycles are loaded when the counter of their module passes zero: the counter at their release shows whether
 * they are late. */
void hal_duties_done(hal_t *hal, uint16_t axis)
{
    if (hal->axis[axis].behind) {
        hal->late++;
    }
}

void port_m1(hal_t *hal)
{
    scope(hal, PIN_SCOPE_M1);
    REG_WRITE(hal, PWMA_BASE + PWM_SM(1U) + PWM_STS, PWM_STS_CMPF(M1_VAL));
    if (adc_take_first(hal)) {
        note_gap(hal);
        hal->axis[0].behind = false;
        servo_m1_isr(hal->servo);
    } else {
        sequence_lost(hal);
    }
    scope(hal, 0U);
}

void port_m2(hal_t *hal)
{
    scope(hal, PIN_SCOPE_M2);
    if (adc_take_second(hal)) {
        hal->m2_runs++;
        hal->losses = (uint16_t)(hal->losses - ((hal->losses > 0U) ? 1U : 0U));
        hal->axis[1].behind = false;
        servo_m2_isr(hal->servo);
        REG_WRITE(hal, ADC_STAT, ADC_STAT_EOSI0);
    } else {
        sequence_lost(hal);
    }
    scope(hal, 0U);
}
