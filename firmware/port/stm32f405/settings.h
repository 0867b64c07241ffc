/* settings.h - every register value of the servo on this board, derived from physical quantities.
 *
 * Change a quantity in the first part; the values in the second follow. What the hardware cannot do does not compile:
 * the name of the failing check states the reason.
 */
#ifndef STM32F405_SETTINGS_H
#define STM32F405_SETTINGS_H

#include <stdint.h>

#include "config/board_gen.h"
#include "port/stm32f405/registers.h"

/* ==== quantities ================================================================================================= */

#define CRYSTAL_HZ UINT32_C(8000000)
#define CORE_CLOCK_HZ UINT32_C(168000000)
#define APB1_CLOCK_HZ (CORE_CLOCK_HZ / 4U) /* its timers run at twice this clock */
#define APB2_CLOCK_HZ (CORE_CLOCK_HZ / 2U) /* its timers run at the clock of the core */
#define ADC_CLOCK_HZ (APB2_CLOCK_HZ / 4U)

/* The low sides conduct symmetrically about their centre, delayed by half the dead time. */
#define AMPLIFIER_DELAY_NS 312U /* input filter 264 ns, output filter 48 ns */
#define ADC_HOLD_NS 286U /* three clocks of latency at most, three of sampling: measure it */

#ifndef SERIAL_BAUD
#define SERIAL_BAUD UINT32_C(115200)
#endif
#define SERIAL_BAUD_MAX UINT32_C(2000000)

#define WATCHDOG_MS 50U
#define LSI_CLOCK_HZ UINT32_C(32000) /* 17 to 47 kHz */

/* DRV8301: start of the supply of the gates, and pauses. */
#define GATE_OFF_US 40U
#define GATE_START_US 20000U
#define GATE_SETTLE_US 100U
#define GATE_CHECK_US 100000U /* between two checks of the registers */
#define SPI_PAUSE_NS 1000U /* nCS high between two frames */

/* Brake half bridge. */
#define BRAKE_PERIOD 4096U /* half period in clocks of TIM2: 10.25 kHz */
#define BRAKE_OFF_PART 20U /* the low side conducts for 1/20 of the period: the bootstrap of the high side */
#define BRAKE_DEAD_NS 500U

/* Interrupt priorities, 0 first. The fast loops share one: they never interrupt each other. */
#define PRIORITY_BREAK 0U
#define PRIORITY_STAMP 1U /* takes the time of an edge, nothing else */
#define PRIORITY_LOOPS 2U
#define PRIORITY_EDGE 3U

/* ==== derived ==================================================================================================== */

#define SETTINGS_CHECK(what, true_condition) typedef char check_##what[(true_condition) ? 1 : -1]

#define TIM5_CLOCKS (CORE_CLOCK_HZ / (2U * APB1_CLOCK_HZ)) /* clocks of the core in a count */
#define CLOCKS_OF_NS(ns) ((uint32_t)(((ns) * (CORE_CLOCK_HZ / 1000000U) + 500U) / 1000U))
#define CLOCKS_OF_US(us) ((us) * (CORE_CLOCK_HZ / 1000000U))

/* ---- clock: crystal / M x N / P ---------------------------------------------------------------------------------- */

#define PLL_M 4U
#define PLL_P 2U
#define PLL_N (CORE_CLOCK_HZ * PLL_P / (CRYSTAL_HZ / PLL_M))
#define PLL_Q 7U /* 48 MHz, of the USB interface, which is not used */
#define FLASH_WAIT_STATES 5U /* 150 to 168 MHz at 2.7 to 3.6 V */

#define SET_RCC_PLLCFGR                                                                                                \
    (RCC_PLLCFGR_PLLM(PLL_M) | RCC_PLLCFGR_PLLN(PLL_N) | RCC_PLLCFGR_PLLP(RCC_PLLCFGR_PLLP_2) | RCC_PLLCFGR_PLLSRC |   \
     RCC_PLLCFGR_PLLQ(PLL_Q))
#define SET_RCC_CFGR_DIVIDERS                                                                                          \
    (RCC_CFGR_HPRE(RCC_CFGR_HPRE_1) | RCC_CFGR_PPRE1(RCC_CFGR_PPRE1_4) | RCC_CFGR_PPRE2(RCC_CFGR_PPRE2_2))
#define SET_RCC_CFGR (SET_RCC_CFGR_DIVIDERS | RCC_CFGR_SW(RCC_CFGR_SW_PLL))
#define SET_FLASH_ACR (FLASH_ACR_LATENCY(FLASH_WAIT_STATES) | FLASH_ACR_PRFTEN | FLASH_ACR_ICEN)

SETTINGS_CHECK(core_clock_within_the_chips_limit, CORE_CLOCK_HZ <= 168000000U);
SETTINGS_CHECK(pll_input_is_2_mhz, CRYSTAL_HZ / PLL_M == 2000000U);
SETTINGS_CHECK(adc_clock_within_the_chips_limit, ADC_CLOCK_HZ <= 36000000U);

#define SET_RCC_AHB1ENR                                                                                                \
    (RCC_AHB1ENR_GPIOAEN | RCC_AHB1ENR_GPIOBEN | RCC_AHB1ENR_GPIOCEN | RCC_AHB1ENR_GPIODEN |                           \
     RCC_AHB1ENR_CCMDATARAMEN | RCC_AHB1ENR_DMA1EN | RCC_AHB1ENR_DMA2EN)
#define SET_RCC_APB1ENR                                                                                                \
    (RCC_APB1ENR_TIM2EN | RCC_APB1ENR_TIM3EN | RCC_APB1ENR_TIM4EN | RCC_APB1ENR_TIM5EN | RCC_APB1ENR_SPI3EN |          \
     RCC_APB1ENR_USART2EN | RCC_APB1ENR_PWREN)
#define SET_RCC_APB2ENR                                                                                                \
    (RCC_APB2ENR_TIM1EN | RCC_APB2ENR_TIM8EN | RCC_APB2ENR_ADC1EN | RCC_APB2ENR_ADC2EN | RCC_APB2ENR_ADC3EN |          \
     RCC_APB2ENR_SYSCFGEN)

/* ---- inverters: count 0 .. PWM_TOP .. 0; a pulse of `width` clocks either side of the high-side centre -------------- */

#define PWM_TOP ((uint32_t)(CORE_CLOCK_HZ / (2U * BOARD_PWM_FREQUENCY_HZ)))
#define PWM_PERIOD (2U * PWM_TOP)
#define DEAD_CLOCKS CLOCKS_OF_NS(BOARD_DEAD_TIME_NS)
/* Without a pulse the low side stays on: a pulse shorter than the dead time would only open it. */
#define PULSE_MIN (DEAD_CLOCKS / 2U)
/* Both low sides with a shunt must conduct at the sample. */
#define PULSE_MAX_SAMPLED (PWM_TOP - CLOCKS_OF_NS(BOARD_LOW_SIDE_NS) / 2U)
#define SAMPLE_DELAY CLOCKS_OF_NS(BOARD_DEAD_TIME_NS / 2U + AMPLIFIER_DELAY_NS - ADC_HOLD_NS)

#define SET_PWM_CR1 (TIM_CR1_CMS(TIM_CR1_CMS_CENTRE_3) | TIM_CR1_ARPE)
#define SET_PWM_CCMR1(mode) (TIM_CCMR1_OC1M(mode) | TIM_CCMR1_OC1PE | TIM_CCMR1_OC2M(mode) | TIM_CCMR1_OC2PE)
#define SET_PWM_CCMR2(mode) (TIM_CCMR2_OC3M(mode) | TIM_CCMR2_OC3PE | TIM_CCMR2_OC4M(mode) | TIM_CCMR2_OC4PE)
#define SET_PWM_CCER (TIM_CCER_CC1E | TIM_CCER_CC1NE | TIM_CCER_CC2E | TIM_CCER_CC2NE | TIM_CCER_CC3E | TIM_CCER_CC3NE)
#define SET_PWM_BDTR_OFF (TIM_BDTR_DTG(DEAD_CLOCKS) | TIM_BDTR_OSSI | TIM_BDTR_OSSR)
#define SET_PWM_BDTR_ON (SET_PWM_BDTR_OFF | TIM_BDTR_MOE)
#define SET_TIM8_SMCR_START (TIM_SMCR_TS(TIM_SMCR_TS_ITR0) | TIM_SMCR_SMS(TIM_SMCR_SMS_TRIGGER))

SETTINGS_CHECK(carrier_divides_the_clock, PWM_PERIOD *BOARD_PWM_FREQUENCY_HZ == CORE_CLOCK_HZ);
SETTINGS_CHECK(dead_time_fits, DEAD_CLOCKS < 128U);
SETTINGS_CHECK(sample_lies_behind_the_centre, BOARD_DEAD_TIME_NS / 2U + AMPLIFIER_DELAY_NS >= ADC_HOLD_NS);

/* ---- converters -------------------------------------------------------------------------------------------------- */

#define CHANNEL_M1_B ADC123_IN_C0
#define CHANNEL_M1_C ADC123_IN_C1
#define CHANNEL_M2_B ADC123_IN_C3
#define CHANNEL_M2_C ADC123_IN_C2
#define CHANNEL_BUS ADC12_IN_A6
#define CHANNEL_HEAT_1 ADC12_IN_C5
#define CHANNEL_HEAT_2 ADC12_IN_A4

#define SET_ADC_COMMON_CCR ADC_COMMON_CCR_ADCPRE(ADC_COMMON_CCR_ADCPRE_4)
#define SET_ADC_CR1 ADC_CR1_SCAN
#define SET_ADC2_CR1 (ADC_CR1_SCAN | ADC_CR1_JEOCIE)
#define SET_ADC_CR2_TRIGGERS                                                                                           \
    (ADC_CR2_JEXTSEL(ADC_CR2_JEXTSEL_TIM1_TRGO) | ADC_CR2_JEXTEN(ADC_CR2_JEXTEN_RISING) |                              \
     ADC_CR2_EXTSEL(ADC_CR2_EXTSEL_TIM8_TRGO) | ADC_CR2_EXTEN(ADC_CR2_EXTEN_RISING) | ADC_CR2_ADON)
#define SET_ADC1_CR2 SET_ADC_CR2_TRIGGERS
#define SET_ADC_CR2_PHASES (SET_ADC_CR2_TRIGGERS | ADC_CR2_DMA | ADC_CR2_DDS)
/* Phases: the shortest time. Bus: ends before the phases. Temperatures: from a resistor of 3.3 kOhm. */
#define SET_ADC1_SMPR1 ADC_SMPR1_SMP(CHANNEL_HEAT_1, ADC_SMPR1_SMP_28_CLOCKS)
#define SET_ADC1_SMPR2                                                                                                 \
    (ADC_SMPR2_SMP(CHANNEL_BUS, ADC_SMPR1_SMP_15_CLOCKS) | ADC_SMPR2_SMP(CHANNEL_HEAT_2, ADC_SMPR1_SMP_28_CLOCKS))
#define SET_ADC1_JSQR                                                                                                  \
    (ADC_JSQR_JL(2U) | ADC_JSQR_JSQ2(CHANNEL_BUS) | ADC_JSQR_JSQ3(CHANNEL_HEAT_1) | ADC_JSQR_JSQ4(CHANNEL_HEAT_2))
#define SET_ADC1_SQR3 ADC_SQR3_SQ1(CHANNEL_BUS)
#define SET_ADC_JSQR(first, second) (ADC_JSQR_JL(1U) | ADC_JSQR_JSQ3(first) | ADC_JSQR_JSQ4(second))
#define SET_ADC_SQR3(first, second) (ADC_SQR3_SQ1(first) | ADC_SQR3_SQ2(second))
#define SET_ADC_SQR1_TWO ADC_SQR1_L(1U)

#define STREAM_ADC2 2U
#define STREAM_ADC3 0U
#define SET_DMA_ADC                                                                                                    \
    (DMA_SCR_DIR(DMA_SCR_DIR_TO_MEMORY) | DMA_SCR_CIRC | DMA_SCR_MINC | DMA_SCR_PSIZE(DMA_SCR_PSIZE_16) |              \
     DMA_SCR_MSIZE(DMA_SCR_MSIZE_16) | DMA_SCR_PL(DMA_SCR_PL_HIGH))
#define SET_DMA_ADC2 (SET_DMA_ADC | DMA_SCR_CHSEL(DMA2_S2_ADC2) | DMA_SCR_TCIE)
#define SET_DMA_ADC3 (SET_DMA_ADC | DMA_SCR_CHSEL(DMA2_S0_ADC3))

/* Codes of a phase beyond which its inverter is switched off. */
#define ADC_MIDDLE 2048
#define OVER_CURRENT_CODES ((int32_t)BOARD_OVER_CURRENT_CODES)

SETTINGS_CHECK(over_current_can_be_measured, BOARD_OVER_CURRENT_CODES >= 1L && BOARD_OVER_CURRENT_CODES < ADC_MIDDLE);

/* ---- encoders ---------------------------------------------------------------------------------------------------- */

#define ENCODER_FILTER_CODE 4U /* six samples at half the clock of the timers */
#define ENCODER_FILTER_CLOCKS 12U
#define TIMER_MHZ (2U * APB1_CLOCK_HZ / 1000000U)
#define ENCODER_TOP UINT32_C(0xFFFF)
#define SET_ENCODER_SMCR TIM_SMCR_SMS(TIM_SMCR_SMS_ENCODER_3)
#define SET_ENCODER_CCMR1                                                                                              \
    (TIM_CCMR1_CC1S(TIM_CCMR1_CC1S_TI1) | TIM_CCMR1_IC1F(ENCODER_FILTER_CODE) | TIM_CCMR1_CC2S(TIM_CCMR1_CC2S_TI2) |   \
     TIM_CCMR1_IC2F(ENCODER_FILTER_CODE))
#define STAMP_SHIFT 8U /* a time stamp is the count of core clocks without its lowest bits */
#define GAP_CLOCKS (3U * PWM_PERIOD / 2U) /* between two M1: one is left out */

SETTINGS_CHECK(time_stamps_divide_the_clock, BOARD_TIMER_CLOCK_HZ << STAMP_SHIFT == CORE_CLOCK_HZ);
SETTINGS_CHECK(encoder_filter_agrees_with_the_board,
               BOARD_ENCODER_FILTER_NS == (1000U * ENCODER_FILTER_CLOCKS + TIMER_MHZ / 2U) / TIMER_MHZ);

/* ---- brake half bridge and monitor outputs: TIM2 ------------------------------------------------------------------ */

/* CH3, inverted PWM mode 2: the low side conducts below CCR3. CH4, PWM mode 2: the high side from CCR4 on. */
#define BRAKE_DEAD_CLOCKS (CLOCKS_OF_NS(BRAKE_DEAD_NS) / 2U)
#define BRAKE_HIGH_FROM (BRAKE_PERIOD / BRAKE_OFF_PART)
#define BRAKE_LOW_BELOW (BRAKE_HIGH_FROM - BRAKE_DEAD_CLOCKS)
#define BRAKE_NEVER_HIGH (BRAKE_PERIOD + 1U)
#define BRAKE_ALWAYS_LOW (BRAKE_PERIOD + 1U)
#define SET_TIM2_CR1 (TIM_CR1_CMS(TIM_CR1_CMS_CENTRE_3) | TIM_CR1_CEN)
#define SET_TIM2_CCMR1 (TIM_CCMR1_OC1M(TIM_CCMR1_OC1M_PWM1) | TIM_CCMR1_OC2M(TIM_CCMR1_OC1M_PWM1))
#define SET_TIM2_CCMR2 (TIM_CCMR2_OC3M(TIM_CCMR1_OC1M_PWM2) | TIM_CCMR2_OC4M(TIM_CCMR1_OC1M_PWM2))
#define SET_TIM2_CCER (TIM_CCER_CC1E | TIM_CCER_CC2E | TIM_CCER_CC3E | TIM_CCER_CC3P | TIM_CCER_CC4E)

SETTINGS_CHECK(brake_dead_time_fits, BRAKE_HIGH_FROM > BRAKE_DEAD_CLOCKS);

/* ---- serial line --------------------------------------------------------------------------------------------------- */

#define SERIAL_DIVIDER(baud) ((APB1_CLOCK_HZ + (baud) / 2U) / (baud)) /* sixteenths of a bit in the fraction */
#define STREAM_RECEIVE 5U
#define STREAM_TRANSMIT 6U
#define SET_USART_CR1 (USART_CR1_UE | USART_CR1_TE | USART_CR1_RE) /* 8 data bits, no parity, 1 stop bit */
#define SET_USART_CR3 (USART_CR3_DMAR | USART_CR3_DMAT)
#define SET_DMA_BYTES (DMA_SCR_MINC | DMA_SCR_PSIZE(DMA_SCR_PSIZE_8) | DMA_SCR_MSIZE(DMA_SCR_MSIZE_8))
#define SET_DMA_RECEIVE                                                                                                \
    (SET_DMA_BYTES | DMA_SCR_CHSEL(DMA1_S5_USART2_RX) | DMA_SCR_DIR(DMA_SCR_DIR_TO_MEMORY) | DMA_SCR_CIRC)
#define SET_DMA_TRANSMIT (SET_DMA_BYTES | DMA_SCR_CHSEL(DMA1_S6_USART2_TX) | DMA_SCR_DIR(DMA_SCR_DIR_TO_PERIPHERAL))

SETTINGS_CHECK(baud_rate_is_not_too_high, SERIAL_BAUD <= SERIAL_BAUD_MAX);
SETTINGS_CHECK(baud_rate_is_not_too_low, SERIAL_DIVIDER(SERIAL_BAUD) <= 0xFFFFU);

/* ---- gate drivers: DRV8301 on SPI3 --------------------------------------------------------------------------------- */

#define SET_SPI_CR1                                                                                                    \
    (SPI_CR1_DFF | SPI_CR1_SSM | SPI_CR1_SSI | SPI_CR1_MSTR | SPI_CR1_CPHA | SPI_CR1_BR(SPI_CR1_BR_16) | SPI_CR1_SPE)
#define DRV_READ(address) (0x8000U | (uint32_t)(address) << 11)
#define DRV_WRITE(address, value) ((uint32_t)(address) << 11 | (value))
#define DRV_DATA UINT32_C(0x7FF)
#define DRV_STATUS_1 0U
#define DRV_STATUS_2 1U
#define DRV_CONTROL_1 2U
#define DRV_CONTROL_2 3U
#define DRV_STATUS_2_GVDD_OV (1U << 7)
#define DRV_CONTROL_1_GATE_RESET (1U << 2)
#define DRV_OCP_LATCH (1U << 4)
#define DRV_OC_ADJ(code) ((uint32_t)(code) << 6)
#define DRV_OC_ADJ_CODE 0U /* 0.060 V, the lowest: some ten amperes */
#define DRV_GAIN(code) ((uint32_t)(code) << 2)
#define DRV_GAIN_80 3U
#define SET_DRV_CONTROL_1 (DRV_OCP_LATCH | DRV_OC_ADJ(DRV_OC_ADJ_CODE)) /* gate current 1.7 A, six inputs */
#define SET_DRV_CONTROL_2 DRV_GAIN(DRV_GAIN_80)
#define DRV_WRITES 5U /* of control register 1 at the start: single ones get lost */

/* ---- flash -------------------------------------------------------------------------------------------------------- */

#define STORED_FIRST_SECTOR 1U
#define SET_FLASH_CR FLASH_CR_PSIZE(FLASH_CR_PSIZE_32)

SETTINGS_CHECK(flash_sectors_are_those_of_16_kb,
               STORED_FIRST_SECTOR + BOARD_FLASH_SECTORS <= 4U &&
                   BOARD_FLASH_SECTOR_WORDS * 4U == FLASH_SECTOR_SIZE(STORED_FIRST_SECTOR));

/* ---- watchdog -------------------------------------------------------------------------------------------------------- */

#define WATCHDOG_COUNTS (WATCHDOG_MS * (LSI_CLOCK_HZ / 1000U) / 4U)
#define SET_IWDG_PR IWDG_PR_PR(IWDG_PR_PR_4)
#define SET_IWDG_RLR IWDG_RLR_RL(WATCHDOG_COUNTS)

SETTINGS_CHECK(watchdog_time_fits, WATCHDOG_COUNTS >= 1U && WATCHDOG_COUNTS <= 0xFFFU);

/* ---- pins that are not of a peripheral (README.md has the table) ------------------------------------------------------ */

#define PIN_FAULT 2U /* D: nFAULT of both gate drivers */
#define PIN_EN_GATE 12U /* B */
#define PIN_SELECT(axis) (13U + (axis)) /* C: nCS */
#define PIN_ENABLE(axis) (axis) /* A: closed contacts to ground */
#define PIN_HOME(axis) ((axis) == 0U ? 9U : 15U) /* C: Z of the encoder plugs */
#define PIN_B(axis) (5U + 2U * (axis)) /* B: encoder channel B */
#define LINE_EDGE(axis) (14U + (axis)) /* raised by software */

#define PORT_A GPIOA_BASE
#define PORT_B GPIOB_BASE
#define PORT_C GPIOC_BASE
#define PORT_D GPIOD_BASE
#define PORT_HOLDING(axis) ((axis) == 0U ? PORT_C : PORT_B) /* coil of the holding brake: C4, B2 */
#define PIN_HOLDING(axis) ((axis) == 0U ? 4U : 2U)

#endif
