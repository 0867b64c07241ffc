/* pwm.c - two inverters on TIM1 and TIM8. The high-side centre of motor 1 is at 0, that of motor 2 at the top. */
#include "port/stm32f405/drivers.h"

/* ---- set up ----------------------------------------------------------------------------------------------------- */

static void timer_init(hal_t *hal, uint32_t base, uint32_t mode, uint32_t sample)
{
    REG_WRITE(hal, base + TIM_CR1, SET_PWM_CR1);
    REG_WRITE(hal, base + TIM_CR2, TIM_CR2_MMS(TIM_CR2_MMS_RESET)); /* idle levels low: all switches open */
    REG_WRITE(hal, base + TIM_SMCR, 0U);
    REG_WRITE(hal, base + TIM_DIER, 0U);
    REG_WRITE(hal, base + TIM_PSC, 0U);
    REG_WRITE(hal, base + TIM_ARR, PWM_TOP);
    REG_WRITE(hal, base + TIM_RCR, TIM_RCR_REP(0U)); /* loads at either end */
    REG_WRITE(hal, base + TIM_CCMR1, SET_PWM_CCMR1(mode));
    REG_WRITE(hal, base + TIM_CCMR2, SET_PWM_CCMR2(mode));
    REG_WRITE(hal, base + TIM_CCR1, PWM_TOP / 2U); /* 50 %, as in the states before RUN */
    REG_WRITE(hal, base + TIM_CCR2, PWM_TOP / 2U);
    REG_WRITE(hal, base + TIM_CCR3, PWM_TOP / 2U);
    REG_WRITE(hal, base + TIM_CCR4, sample);
    REG_WRITE(hal, base + TIM_BDTR, SET_PWM_BDTR_OFF);
    REG_WRITE(hal, base + TIM_CCER, SET_PWM_CCER);
    REG_WRITE(hal, base + TIM_EGR, TIM_EGR_UG);
    REG_WRITE(hal, base + TIM_CNT, 0U);
}

/* OC4REF rises behind the low-side centre: on the way down for motor 1, on the way up for motor 2. */
void pwm_init(hal_t *hal)
{
    timer_init(hal, TIM1_BASE, TIM_CCMR1_OC1M_PWM1, PWM_TOP - SAMPLE_DELAY);
    timer_init(hal, TIM8_BASE, TIM_CCMR1_OC1M_PWM2, SAMPLE_DELAY);
}

/* The enable of TIM1 starts TIM8; from then on both outputs of a trigger are those of the converters. */
bool pwm_run(hal_t *hal)
{
    REG_WRITE(hal, TIM8_BASE + TIM_SMCR, SET_TIM8_SMCR_START);
    REG_WRITE(hal, TIM1_BASE + TIM_CR2, TIM_CR2_MMS(TIM_CR2_MMS_ENABLE));
    REG_WRITE(hal, TIM1_BASE + TIM_CR1, SET_PWM_CR1 | TIM_CR1_CEN);
    const bool both = wait_for(hal, TIM8_BASE + TIM_CR1, TIM_CR1_CEN, TIM_CR1_CEN);
    REG_WRITE(hal, TIM8_BASE + TIM_SMCR, 0U);
    REG_WRITE(hal, TIM1_BASE + TIM_CR2, TIM_CR2_MMS(TIM_CR2_MMS_OC4REF));
    REG_WRITE(hal, TIM8_BASE + TIM_CR2, TIM_CR2_MMS(TIM_CR2_MMS_OC4REF));
    return both;
}

/* ---- duties ----------------------------------------------------------------------------------------------------- */

/* Half the clocks that the high side is on. */
static uint32_t half_pulse(int16_t duty, uint32_t most)
{
    const uint32_t half = ((uint32_t)duty * PWM_TOP + UINT32_C(0x4000)) >> 15;
    return (half < PULSE_MIN) ? 0U : (half > most) ? most : half;
}

/* Motor 2 counts from the low-side centre; without a pulse the compare is never reached. */
static void write_pulse(hal_t *hal, uint16_t axis, uint32_t compare, uint32_t half)
{
    const uint32_t never = PWM_TOP + 1U;
    REG_WRITE(hal, hal->axis[axis].pwm + compare, (axis == M1) ? half : (half == 0U) ? never : PWM_TOP - half);
}

/* No load while the three values are written. They are late if the counter has passed the high-side centre: motor 1
 * counts down to it, motor 2 up. */
void hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c)
{
    const uint32_t base = hal->axis[axis].pwm;
    const uint32_t counts = REG_READ(hal, base + TIM_CR1) & TIM_CR1_CEN; /* not before pwm_run */
    REG_WRITE(hal, base + TIM_CR1, SET_PWM_CR1 | counts | TIM_CR1_UDIS);
    write_pulse(hal, axis, TIM_CCR1, half_pulse(duty_a, PWM_TOP));
    write_pulse(hal, axis, TIM_CCR2, half_pulse(duty_b, PULSE_MAX_SAMPLED));
    write_pulse(hal, axis, TIM_CCR3, half_pulse(duty_c, PULSE_MAX_SAMPLED));
    REG_WRITE(hal, base + TIM_CR1, SET_PWM_CR1 | counts);
    const bool down = (REG_READ(hal, base + TIM_CR1) & TIM_CR1_DIR) != 0U;
    hal->axis[axis].behind = down != (axis == M1);
}

/* ---- switches --------------------------------------------------------------------------------------------------- */

void switches_open(hal_t *hal, uint16_t axis) { REG_WRITE(hal, hal->axis[axis].pwm + TIM_BDTR, SET_PWM_BDTR_OFF); }

/* Without a bus supply the drivers have not started, although nothing has tripped. */
static bool locked(const hal_t *hal, const port_axis_t *axis)
{
    return hal->gate != GATE_READY || axis->tripped || (axis->enable_used && axis->opened);
}

/* An interrupt above this one may open the switches between the test and the write: test again. */
void hal_pwm_enable(hal_t *hal, uint16_t axis, bool on)
{
    const port_axis_t *state = &hal->axis[axis];
    if (on && !locked(hal, state)) {
        REG_WRITE(hal, state->pwm + TIM_BDTR, SET_PWM_BDTR_ON);
        if (!locked(hal, state)) {
            return;
        }
    }
    switches_open(hal, axis);
}
