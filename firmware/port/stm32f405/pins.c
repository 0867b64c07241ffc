/* pins.c - functions of the pins; switches, enable inputs, holding brakes. */
#include "port/stm32f405/drivers.h"
#include "port/stm32f405/port.h"

typedef struct {
    uint32_t port;
    uint8_t pin;
    uint8_t mode;
    uint8_t function; /* of an alternate function */
    uint8_t pull;
} pin_t;

#define ANALOG(port, pin) {(port), (pin), GPIO_MODER_ANALOG, 0U, GPIO_PUPDR_NONE}
#define INPUT(port, pin) {(port), (pin), GPIO_MODER_INPUT, 0U, GPIO_PUPDR_UP}
#define OUTPUT(port, pin) {(port), (pin), GPIO_MODER_OUTPUT, 0U, GPIO_PUPDR_NONE}
#define FUNCTION(port, pin, code) {(port), (pin), GPIO_MODER_ALTERNATE, (code), GPIO_PUPDR_NONE}
#define FUNCTION_UP(port, pin, code) {(port), (pin), GPIO_MODER_ALTERNATE, (code), GPIO_PUPDR_UP}

/* An open contact and an unplugged host read high. The encoders and the gates have their resistors on the board. */
static const pin_t pins[] = {
    FUNCTION(PORT_A, 8, AF_A8_TIM1_CH1), /* motor 1 */
    FUNCTION(PORT_A, 9, AF_A9_TIM1_CH2),
    FUNCTION(PORT_A, 10, AF_A10_TIM1_CH3),
    FUNCTION(PORT_B, 13, AF_B13_TIM1_CH1N),
    FUNCTION(PORT_B, 14, AF_B14_TIM1_CH2N),
    FUNCTION(PORT_B, 15, AF_B15_TIM1_CH3N),
    FUNCTION(PORT_C, 6, AF_C6_TIM8_CH1), /* motor 2 */
    FUNCTION(PORT_C, 7, AF_C7_TIM8_CH2),
    FUNCTION(PORT_C, 8, AF_C8_TIM8_CH3),
    FUNCTION(PORT_A, 7, AF_A7_TIM8_CH1N),
    FUNCTION(PORT_B, 0, AF_B0_TIM8_CH2N),
    FUNCTION(PORT_B, 1, AF_B1_TIM8_CH3N),
    FUNCTION(PORT_B, 10, AF_B10_TIM2_CH3), /* brake half bridge */
    FUNCTION(PORT_B, 11, AF_B11_TIM2_CH4),
    FUNCTION(PORT_A, 15, AF_A15_TIM2_CH1), /* monitor outputs */
    FUNCTION(PORT_B, 3, AF_B3_TIM2_CH2),
    FUNCTION(PORT_B, 4, AF_B4_TIM3_CH1), /* encoders */
    FUNCTION(PORT_B, 5, AF_B5_TIM3_CH2),
    FUNCTION(PORT_B, 6, AF_B6_TIM4_CH1),
    FUNCTION(PORT_B, 7, AF_B7_TIM4_CH2),
    FUNCTION(PORT_C, 10, AF_C10_SPI3_SCK), /* gate drivers */
    FUNCTION(PORT_C, 11, AF_C11_SPI3_MISO),
    FUNCTION(PORT_C, 12, AF_C12_SPI3_MOSI),
    OUTPUT(PORT_C, PIN_SELECT(0U)),
    OUTPUT(PORT_C, PIN_SELECT(1U)),
    OUTPUT(PORT_B, PIN_EN_GATE),
    INPUT(PORT_D, PIN_FAULT),
    FUNCTION(PORT_A, 2, AF_A2_USART2_TX), /* host */
    FUNCTION_UP(PORT_A, 3, AF_A3_USART2_RX),
    ANALOG(PORT_C, 0), /* phases */
    ANALOG(PORT_C, 1),
    ANALOG(PORT_C, 2),
    ANALOG(PORT_C, 3),
    ANALOG(PORT_A, 6), /* bus, temperatures */
    ANALOG(PORT_C, 5),
    ANALOG(PORT_A, 4),
    INPUT(PORT_A, PIN_ENABLE(0U)),
    INPUT(PORT_A, PIN_ENABLE(1U)),
    INPUT(PORT_C, PIN_HOME(0U)),
    INPUT(PORT_C, PIN_HOME(1U)),
    OUTPUT(PORT_HOLDING(0U), PIN_HOLDING(0U)),
    OUTPUT(PORT_HOLDING(1U), PIN_HOLDING(1U)),
};

static void change(hal_t *hal, uint32_t address, uint32_t mask, uint32_t value)
{
    REG_WRITE(hal, address, (REG_READ(hal, address) & ~mask) | value);
}

static void set_up(hal_t *hal, const pin_t *p)
{
    if (p->pin < 8U) {
        change(hal, p->port + GPIO_AFRL, GPIO_AFRL_AFRL(p->pin, 15U), GPIO_AFRL_AFRL(p->pin, p->function));
    } else {
        change(hal, p->port + GPIO_AFRH, GPIO_AFRH_AFRH(p->pin, 15U), GPIO_AFRH_AFRH(p->pin, p->function));
    }
    change(hal, p->port + GPIO_OSPEEDR, GPIO_OSPEEDR_OSPEEDR(p->pin, 3U),
           GPIO_OSPEEDR_OSPEEDR(p->pin, (p->mode == GPIO_MODER_ALTERNATE) ? GPIO_OSPEEDR_MEDIUM : GPIO_OSPEEDR_LOW));
    change(hal, p->port + GPIO_PUPDR, GPIO_PUPDR_PUPDR(p->pin, 3U), GPIO_PUPDR_PUPDR(p->pin, p->pull));
    change(hal, p->port + GPIO_MODER, GPIO_MODER_MODER(p->pin, 3U), GPIO_MODER_MODER(p->pin, p->mode));
}

/* Interrupt line n of pin n of a port. */
static void select_line(hal_t *hal, uint32_t line, uint32_t port)
{
    change(hal, SYSCFG_BASE + SYSCFG_EXTICR(line), SYSCFG_EXTICR_EXTI(line, 15U), SYSCFG_EXTICR_EXTI(line, port));
}

/* Levels of outputs before their function. */
void pins_init(hal_t *hal)
{
    set_pin(hal, PORT_B, PIN_EN_GATE, false);
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        set_pin(hal, PORT_C, PIN_SELECT(axis), true);
        hal_holding_brake(hal, axis, false);
    }
    for (uint16_t i = 0; i < sizeof pins / sizeof pins[0]; i++) {
        set_up(hal, &pins[i]);
    }
    select_line(hal, PIN_FAULT, SYSCFG_EXTICR_D);
    REG_WRITE(hal, EXTI_BASE + EXTI_FTSR, EXTI_FTSR_TR(PIN_FAULT) | EXTI_FTSR_TR(PIN_B(0U)) | EXTI_FTSR_TR(PIN_B(1U)));
    uint32_t rising = 0;
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        select_line(hal, PIN_ENABLE(axis), SYSCFG_EXTICR_A);
        select_line(hal, PIN_B(axis), SYSCFG_EXTICR_B);
        rising |= EXTI_RTSR_TR(PIN_ENABLE(axis)) | EXTI_RTSR_TR(PIN_B(axis));
    }
    REG_WRITE(hal, EXTI_BASE + EXTI_RTSR, rising);
    REG_WRITE(hal, EXTI_BASE + EXTI_IMR,
              EXTI_IMR_MR(PIN_FAULT) | EXTI_IMR_MR(PIN_ENABLE(0U)) | EXTI_IMR_MR(PIN_ENABLE(1U)) |
                  EXTI_IMR_MR(LINE_EDGE(0U)) | EXTI_IMR_MR(LINE_EDGE(1U)));
}

void hal_holding_brake(hal_t *hal, uint16_t axis, bool release)
{
    set_pin(hal, PORT_HOLDING(axis), PIN_HOLDING(axis), release);
}

/* The board has no pins for limit switches: an axis that uses them reads both as reached, and does not move. */
uint16_t hal_inputs(hal_t *hal, uint16_t axis)
{
    const port_axis_t *state = &hal->axis[axis];
    const bool home = !pin_is_high(hal, PORT_C, PIN_HOME(axis));
    const bool enabled = !state->opened && !pin_is_high(hal, PORT_A, PIN_ENABLE(axis));
    return (uint16_t)((home ? HAL_INPUT_HOME : 0U) | HAL_INPUT_LIMIT_MIN | HAL_INPUT_LIMIT_MAX |
                      (enabled ? HAL_INPUT_ENABLE : 0U));
}

/* The flag keeps the switches open, like that of the over-current. An opening behind the read of the pin sets it
 * again. */
void hal_enable_input(hal_t *hal, uint16_t axis, bool used)
{
    port_axis_t *state = &hal->axis[axis];
    state->enable_used = used;
    state->opened = false;
    if (pin_is_high(hal, PORT_A, PIN_ENABLE(axis))) {
        state->opened = true;
    }
    if (used && state->opened) {
        switches_open(hal, axis);
    }
}

static void enable_opened(hal_t *hal, uint16_t axis)
{
    REG_WRITE(hal, EXTI_BASE + EXTI_PR, EXTI_PR_PR(PIN_ENABLE(axis)));
    hal->axis[axis].opened = true;
    if (hal->axis[axis].enable_used) {
        switches_open(hal, axis);
    }
}

void port_enable_1(hal_t *hal) { enable_opened(hal, M1); }

void port_enable_2(hal_t *hal) { enable_opened(hal, M2); }
