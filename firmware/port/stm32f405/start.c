/* start.c - start of the board (DRM 4.3), and priorities of the interrupts. */
#include "port/stm32f405/drivers.h"
#include "port/stm32f405/port.h"
#include "port/stm32f405/vectors.h"

static void state_init(hal_t *hal, servo_t *servo)
{
    static const uint32_t pwm[HAL_AXES] = {TIM1_BASE, TIM8_BASE};
    static const uint32_t encoder[HAL_AXES] = {TIM3_BASE, TIM4_BASE};
    const adc_pair_t middle = {ADC_MIDDLE, ADC_MIDDLE};
    hal->servo = servo;
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        hal->axis[i] = (port_axis_t){
            .pwm = pwm[i],
            .encoder = encoder[i],
            .currents = middle,
            .offsets = middle,
        };
    }
    hal->bus = 0;
    hal->watchdog_reset = (REG_READ(hal, RCC_BASE + RCC_CSR) & RCC_CSR_WDGRSTF) != 0U;
    REG_WRITE(hal, RCC_BASE + RCC_CSR, RCC_CSR_RMVF);
    hal->losses = 0;
    hal->late = 0;
    hal->last = 0;
    hal->m2_runs = 0;
    hal->running = false;
}

/* A request that came and went during the start, as that of the gate drivers' fault line, is still pending. */
#define ENABLE(number, priority, handler)                                                                              \
    REG_WRITE(hal, NVIC_BASE + NVIC_ICPR(number), NVIC_IRQ(number));                                                   \
    REG_WRITE(hal, NVIC_BASE + NVIC_IPR(number),                                                                       \
              (REG_READ(hal, NVIC_BASE + NVIC_IPR(number)) & ~NVIC_IPR_IPR(number, 0xFFU)) |                           \
                  NVIC_IPR_IPR(number, (priority) << (8U - NVIC_PRIORITY_BITS)));                                      \
    REG_WRITE(hal, NVIC_BASE + NVIC_ISER(number), NVIC_IRQ(number));

void interrupts_init(hal_t *hal) { PORT_VECTORS(ENABLE) }

/* The switches are open before a pin is given to a timer. */
static bool peripherals_init(hal_t *hal)
{
    debug_freeze(hal, true);
    if (!clock_init(hal)) {
        return false;
    }
    pwm_init(hal);
    brake_init(hal);
    pins_init(hal);
    encoders_init(hal);
    serial_init(hal);
    gate_start(hal);
    adc_init(hal);
    return true;
}

/* The first trigger behind adc_arm() is that of motor 1: motor 2's has passed since the carriers have started. */
bool port_init(hal_t *hal, servo_t *servo, const servo_config_t *config)
{
    state_init(hal, servo);
    if (!peripherals_init(hal)) {
        watchdog_start(hal);
        return false;
    }
    servo_init(servo, hal, config);
    interrupts_init(hal);
    watchdog_start(hal);
    if (!pwm_run(hal)) {
        return false;
    }
    adc_arm(hal);
    INTERRUPTS_ON(hal);
    return true;
}
