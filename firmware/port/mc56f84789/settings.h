/* settings.h - every register value of the servo, derived from physical quantities.
 *
 * Change a quantity in the first part; the values in the second follow. What the hardware cannot do does not compile:
 * the name of the failing check states the reason. All values are integer constant expressions, also where int has 16
 * bits.
 */
#ifndef PORT_SETTINGS_H
#define PORT_SETTINGS_H

#include <stdint.h>

#include "config/board_gen.h"
#include "port/mc56f84789/registers.h"

/* ==== quantities ================================================================================================= */

/* Clock. */
#ifndef CRYSTAL_HZ
#define CRYSTAL_HZ 8000000UL
#endif
#ifndef BUS_CLOCK_HZ
#define BUS_CLOCK_HZ 100000000UL /* core, bus and peripherals (DRM 4.3.1) */
#endif
#define RC_CLOCK_HZ 8000000UL /* internal oscillator */

/* Inverters. */
#ifndef PWM_FREQUENCY_HZ
#define PWM_FREQUENCY_HZ BOARD_PWM_FREQUENCY_HZ
#endif
#ifndef DEAD_TIME_NS
#define DEAD_TIME_NS BOARD_DEAD_TIME_NS
#endif
#ifndef HALF_PULSE_MIN_CLOCKS
#define HALF_PULSE_MIN_CLOCKS 2 /* VAL2 = VAL3 is not defined; shorter pulses are none */
#endif
#ifndef SYNC_LATENCY_CLOCKS
#define SYNC_LATENCY_CLOCKS 0 /* VAL0 of PWMA to INIT of PWMB through the crossbar: measure it */
#endif
#ifndef FAULT_FILTER_NS
#define FAULT_FILTER_NS 100UL /* over-current comparator */
#endif
#define FAULT_FILTER_SAMPLES 5UL
#ifndef FAULT_HIGH
#define FAULT_HIGH 1 /* level of the comparator's output that means over-current */
#endif

/* Currents and bus. The low sides conduct symmetrically about the carrier's end, delayed by half the dead time: an edge
 * of the leg voltage comes with the dead time or without it, as the current flows. */
#ifndef AMPLIFIER_DELAY_NS
#define AMPLIFIER_DELAY_NS 200UL /* shunt amplifier and its filter */
#endif
#ifndef ADC_HOLD_NS
#define ADC_HOLD_NS 150UL /* from the compare to the instant that the converter holds: measure it */
#endif
#ifndef ADC_CLOCK_HZ
#define ADC_CLOCK_HZ 20000000UL
#endif
#ifndef ADC_PAIRS
#define ADC_PAIRS 3U /* parallel conversions per motor (DRM F35): currents, the other motor's offsets, bus */
#endif
#define ADC_FIRST_HALF_CLOCKS 17UL /* first conversion of a scan or after a pause: 8.5 ADC clocks */
#define ADC_NEXT_HALF_CLOCKS 12UL  /* each further one: 6 ADC clocks */
#ifndef ADC_START_ADC_CLOCKS
#define ADC_START_ADC_CLOCKS 4UL /* at most, from the compare through crossbars to the first ADC clock: measure it */
#endif

/* Encoders; lines and speeds are configuration of an axis. */
#ifndef ENCODER_FILTER_NS
#define ENCODER_FILTER_NS BOARD_ENCODER_FILTER_NS /* an edge may follow after two of them, less tolerances */
#endif
#define ENCODER_FILTER_SAMPLES 4UL
#ifndef TIME_STAMP_DIVIDER
#define TIME_STAMP_DIVIDER (BUS_CLOCK_HZ / BOARD_TIMER_CLOCK_HZ) /* of TMRx1 and TMRx3 (DRM 2.4.4) */
#endif

/* Serial line and watchdog. */
#ifndef SERIAL_BAUD
#define SERIAL_BAUD 115200UL
#endif
#ifndef SERIAL_CLOCK_DOUBLE
#define SERIAL_CLOCK_DOUBLE 0 /* 1: the interface runs on twice the bus clock, for high rates */
#endif
#ifndef WATCHDOG_MS
#define WATCHDOG_MS 50UL
#endif
#define WATCHDOG_PRESCALER 1024UL

/* Interrupt levels of peripherals, 0-2: the break is above all, M1 and M2 never nest (they share the level). */
#define LEVEL_BREAK 2U
#define LEVEL_LOOPS 1U
#define LEVEL_EDGE 0U
#define LEVEL_SERIAL 2U /* at 2 Mbaud the FIFO is full 5 us after the interrupt */

/* ==== derived ==================================================================================================== */

#define SETTINGS_CHECK(what, true_condition) typedef char check_##what[(true_condition) ? 1 : -1]

#define CLOCKS_OF_NS(ns) (((ns) * (BUS_CLOCK_HZ / 1000000UL) + 500UL) / 1000UL)
#define WORD(value) ((uint16_t)(value)) /* two's complement of a signed count */

/* ---- clock: crystal -> PLL -> /2 -> postscaler -> /2 ------------------------------------------------------------ */

#define PLL_MIN_HZ 240000000UL
#define PLL_MAX_HZ 400000000UL
#define PLL_POSTSCALE (4UL * BUS_CLOCK_HZ >= PLL_MIN_HZ ? 0U : 8UL * BUS_CLOCK_HZ >= PLL_MIN_HZ ? 1U : 2U)
#define PLL_HZ ((4UL * BUS_CLOCK_HZ) << PLL_POSTSCALE)
#define PLL_MULTIPLIER (PLL_HZ / CRYSTAL_HZ)
#define LOSS_OF_REFERENCE_TRIP 2U /* as after reset */

#define SET_OCCS_DIVBY                                                                                                 \
    (OCCS_DIVBY_LORTP(LOSS_OF_REFERENCE_TRIP) | OCCS_DIVBY_COD(PLL_POSTSCALE) | OCCS_DIVBY_PLLDB(PLL_MULTIPLIER - 1UL))
#define SET_OCCS_CTRL_CRYSTAL (OCCS_CTRL_PRECS(OCCS_PRECS_EXTERNAL) | OCCS_CTRL_PLLPD)
#define SET_OCCS_CTRL_PLL (OCCS_CTRL_PRECS(OCCS_PRECS_EXTERNAL) | OCCS_CTRL_LCKON)
#define SET_OCCS_CTRL_RUN (SET_OCCS_CTRL_PLL | OCCS_CTRL_ZSRC)

SETTINGS_CHECK(bus_clock_within_the_chips_limit, BUS_CLOCK_HZ <= 100000000UL);
SETTINGS_CHECK(crystal_within_the_chips_limits, CRYSTAL_HZ >= 4000000UL && CRYSTAL_HZ <= 16000000UL);
SETTINGS_CHECK(pll_in_range, PLL_HZ >= PLL_MIN_HZ && PLL_HZ <= PLL_MAX_HZ);
SETTINGS_CHECK(pll_is_a_multiple_of_the_crystal, PLL_HZ % CRYSTAL_HZ == 0UL);
SETTINGS_CHECK(pll_multiplier_fits, PLL_MULTIPLIER >= 1UL && PLL_MULTIPLIER <= 64UL);
SETTINGS_CHECK(bus_clock_is_whole_megahertz, BUS_CLOCK_HZ % 1000000UL == 0UL);

/* ---- PWM: signed counters -half .. half - 1, pulses -h .. h about zero ------------------------------------------ */

#define PWM_SM_USED 3U
#define PWM_ALL (BIT(PWM_SM_USED) - 1U) /* one bit per submodule */
#define PWM_PERIOD (BUS_CLOCK_HZ / PWM_FREQUENCY_HZ)
#define PWM_HALF_PERIOD ((int32_t)(PWM_PERIOD / 2UL))

#define SET_PWM_INIT WORD(-PWM_HALF_PERIOD)
#define SET_PWM_VAL1 WORD(PWM_HALF_PERIOD - 1)
#define SET_PWM_NEVER 0x7FFFU /* far beyond VAL1 */
#define SET_PWM_VAL0 WORD(0) /* half-cycle reload */
#define SET_PWMA_SM0_VAL0 WORD(-(int32_t)SYNC_LATENCY_CLOCKS) /* sync of PWMB */

#define DEAD_TIME_CLOCKS CLOCKS_OF_NS(DEAD_TIME_NS)
#define SET_PWM_DTCNT WORD(DEAD_TIME_CLOCKS)

SETTINGS_CHECK(pwm_period_is_whole_clocks, BUS_CLOCK_HZ % PWM_FREQUENCY_HZ == 0UL);
SETTINGS_CHECK(pwm_period_is_even, PWM_PERIOD % 2UL == 0UL);
SETTINGS_CHECK(pwm_period_fits_the_counter, PWM_HALF_PERIOD <= 0x8000L);
SETTINGS_CHECK(a_compare_can_be_out_of_reach, PWM_HALF_PERIOD <= 0x4000L);
SETTINGS_CHECK(dead_time_fits_its_counter, DEAD_TIME_CLOCKS <= (uint32_t)PWM_DTCNT_MASK);
SETTINGS_CHECK(dead_time_is_not_zero, DEAD_TIME_CLOCKS >= 1UL);
SETTINGS_CHECK(dead_time_leaves_a_pulse, 8UL * DEAD_TIME_CLOCKS <= PWM_PERIOD);
SETTINGS_CHECK(shortest_pulse_is_swallowed,
               HALF_PULSE_MIN_CLOCKS >= 2 && 2UL * HALF_PULSE_MIN_CLOCKS <= DEAD_TIME_CLOCKS);

/* Master, its followers, and the module that an event of the master starts (DRM F33). Reload at VAL0 only: a new duty is
 * in force half a period after the sample that it answers. */
#define SET_PWM_CTRL PWM_CTRL_HALF
#define SET_PWMA_SM0_CTRL2 PWM_CTRL2_INIT_SEL(PWM_INIT_SEL_LOCAL_SYNC)
#define SET_PWMA_SM12_CTRL2 (PWM_CTRL2_INIT_SEL(PWM_INIT_SEL_MASTER_SYNC) | PWM_CTRL2_RELOAD_SEL)
#define SET_PWMB_SM0_CTRL2 PWM_CTRL2_INIT_SEL(PWM_INIT_SEL_EXT_SYNC)
#define SET_PWMB_SM12_CTRL2 (PWM_CTRL2_INIT_SEL(PWM_INIT_SEL_EXT_SYNC) | PWM_CTRL2_RELOAD_SEL)

#define SET_PWM_OCTRL (PWM_OCTRL_PWMAFS(PWM_FAULT_STATE_LOW) | PWM_OCTRL_PWMBFS(PWM_FAULT_STATE_LOW))
#define SET_PWM_OUTEN (PWM_OUTEN_A(PWM_ALL) | PWM_OUTEN_B(PWM_ALL))

/* Monitor outputs: submodule 3 of PWMB, both outputs by themselves, loaded at once. */
#define MONITOR_SM 3U
#define SET_MONITOR_CTRL (PWM_CTRL_FULL | PWM_CTRL_LDMOD)
#define SET_MONITOR_CTRL2 (PWM_CTRL2_INDEP | PWM_CTRL2_INIT_SEL(PWM_INIT_SEL_LOCAL_SYNC))
#define SET_MONITOR_DISMAP PWM_DISMAP_ONES
#define SET_MONITOR_OUTEN (PWM_OUTEN_A(BIT(MONITOR_SM)) | PWM_OUTEN_B(BIT(MONITOR_SM)))

/* The comparator is fault 0 of its module and switches A and B off without software; PWMX is not in use. */
#define FAULT_INPUT BIT(0)
#define ENABLE_INPUT BIT(1) /* fault 1: enable input, if fitted; high when open */
#define PWM_DISMAP0_OF(faults) (PWM_DISMAP_ONES | PWM_DISMAP_X_MASK | PWM_DISMAP_B(faults) | PWM_DISMAP_A(faults))
#define SET_PWM_DISMAP0 PWM_DISMAP0_OF(FAULT_INPUT)
#define SET_PWM_DISMAP0_ENABLE PWM_DISMAP0_OF(FAULT_INPUT | ENABLE_INPUT)
#define SET_PWM_DISMAP1 (PWM_DISMAP_ONES | PWM_DISMAP_X_MASK)
/* Safe mode: the outputs come back at a cycle's start when software has cleared the flag and the pin agrees. */
#define SET_PWM_FCTRL0_SILENT                                                                                          \
    (PWM_FCTRL_FLVL((FAULT_HIGH ? FAULT_INPUT : 0U) | ENABLE_INPUT) | PWM_FCTRL_FSAFE(FAULT_INPUT | ENABLE_INPUT))
#define SET_PWM_FCTRL0 (SET_PWM_FCTRL0_SILENT | PWM_FCTRL_FIE(FAULT_INPUT))
#define SET_PWM_FSTS0 PWM_FSTS_FFULL(FAULT_INPUT | ENABLE_INPUT)
#define FAULT_FILTER_PERIOD (CLOCKS_OF_NS(FAULT_FILTER_NS) / FAULT_FILTER_SAMPLES)
#define SET_PWM_FFILT0 (PWM_FFILT_FILT_CNT(FAULT_FILTER_SAMPLES - 3UL) | PWM_FFILT_FILT_PER(FAULT_FILTER_PERIOD))

SETTINGS_CHECK(fault_filter_can_be_set, FAULT_FILTER_PERIOD >= 1UL && FAULT_FILTER_PERIOD <= 255UL);

/* ---- sampling (DRM F34) ----------------------------------------------------------------------------------------- */

#define ADC_DIVIDER (BUS_CLOCK_HZ / ADC_CLOCK_HZ)
#define ADC_SPEED_CODE                                                                                                 \
    (ADC_CLOCK_HZ <= 5000000UL ? 0U : ADC_CLOCK_HZ <= 10000000UL ? 1U : ADC_CLOCK_HZ <= 15000000UL ? 2U : 3U)
#define ADC_HALF_SCAN_HALF_CLOCKS (ADC_FIRST_HALF_CLOCKS + (ADC_PAIRS - 1U) * ADC_NEXT_HALF_CLOCKS)
#define ADC_HALF_SCAN_CLOCKS ((ADC_HALF_SCAN_HALF_CLOCKS * ADC_DIVIDER + 1UL) / 2UL)
#define ADC_START_CLOCKS (ADC_START_ADC_CLOCKS * ADC_DIVIDER)

#define SAMPLE_DELAY_CLOCKS CLOCKS_OF_NS(DEAD_TIME_NS / 2UL + AMPLIFIER_DELAY_NS - ADC_HOLD_NS)
#define SAMPLE_COUNT (-PWM_HALF_PERIOD + (int32_t)SAMPLE_DELAY_CLOCKS) /* t0, t2 */
#define M1_COUNT (SAMPLE_COUNT + (int32_t)(ADC_START_CLOCKS + ADC_HALF_SCAN_CLOCKS)) /* t1 */
#define M2_SCAN_COUNT (M1_COUNT + PWM_HALF_PERIOD) /* t3 in counts of PWMA */
#define START_COUNT ((M2_SCAN_COUNT + PWM_HALF_PERIOD) / 2) /* half-way from motor 2's scan to the next period */

#define SET_PWM_VAL4 WORD(SAMPLE_COUNT)
#define SET_PWMA_SM1_VAL5 WORD(M1_COUNT)
#define SET_PWMA_SM0_VAL5 WORD(START_COUNT)

/* Compare events: which VAL of which submodule does what. */
#define SYNC_VAL 0U
#define SAMPLE_VAL 4U
#define M1_VAL 5U
#define START_VAL 5U
#define SET_PWMA_SM0_TCTRL PWM_TCTRL_OUT_TRIG_EN(SYNC_VAL)
#define SET_TCTRL_SAMPLE PWM_TCTRL_OUT_TRIG_EN(SAMPLE_VAL)

SETTINGS_CHECK(adc_clock_within_the_chips_limit, ADC_CLOCK_HZ <= 20000000UL);
SETTINGS_CHECK(adc_clock_divides_the_bus_clock, BUS_CLOCK_HZ % ADC_CLOCK_HZ == 0UL);
SETTINGS_CHECK(adc_divider_fits, ADC_DIVIDER >= 2UL && ADC_DIVIDER <= 64UL);
SETTINGS_CHECK(adc_pause_is_where_the_documents_agree, ADC_PAIRS >= 1U && ADC_PAIRS <= 3U);
SETTINGS_CHECK(sample_lies_behind_the_centre, DEAD_TIME_NS / 2UL + AMPLIFIER_DELAY_NS >= ADC_HOLD_NS);
SETTINGS_CHECK(sample_lies_in_the_first_half, M1_COUNT < 0L);
SETTINGS_CHECK(start_interrupt_has_time, PWM_HALF_PERIOD - START_COUNT >= (int32_t)CLOCKS_OF_NS(5000UL));

#define ADC_MODE (ADC_CTRL1_SMODE(ADC_SMODE_TRIGGERED_PARALLEL) | ADC_CTRL1_SYNC0)
#define SET_ADC_CTRL1_STOPPED (ADC_MODE | ADC_CTRL1_STOP0)
#define SET_ADC_CTRL1_ARMED (ADC_MODE | ADC_CTRL1_EOSIE0)
#define SET_ADC_CTRL2 (ADC_CTRL2_SIMULT | ADC_CTRL2_DIV0(ADC_DIVIDER - 1UL))
#define SET_ADC_CTRL2_STOPPED (SET_ADC_CTRL2 | ADC_CTRL2_STOP1)
#define SET_ADC_PWR2                                                                                                   \
    (ADC_PWR2_DIV1(ADC_DIVIDER - 1UL) | ADC_PWR2_SPEEDA(ADC_SPEED_CODE) | ADC_PWR2_SPEEDB(ADC_SPEED_CODE))
#define ADC_PAIRS_MASK(first, count) ((BIT(count) - 1U) << (first))
#define ADC_SAMPLES_MASK(first, count) FIELD(0, 0x101U * ADC_PAIRS_MASK(first, count)) /* samples of both converters */
#define SET_ADC_SDIS ADC_SAMPLES_MASK(2U * ADC_PAIRS, 8U - 2U * ADC_PAIRS)
#define SET_ADC_SCTRL BIT(ADC_PAIRS) /* the first pair of motor 2 waits for the second trigger */
#define SET_ADC_STAT_CLEAR (ADC_STAT_EOSI0 | ADC_STAT_EOSI1)

/* Pairs of the scan (DRM F35) and channels of the board. Phase b has a channel on either converter: any two phases can be
 * taken at once. The reference pads ANA2, ANA3, ANB2 and ANB3 stay free. */
#define PAIR_M1_CURRENTS 0U
#define PAIR_M2_OFFSETS 1U
#define PAIR_BUS_1 2U
#define PAIR_M2_CURRENTS 3U
#define PAIR_M1_OFFSETS 4U
#define PAIR_BUS_2 5U
#define CHANNEL_M1_A ADC_ANA(0U) /* phase a, converter A */
#define CHANNEL_M1_B ADC_ANA(1U)
#define CHANNEL_M1_B2 ADC_ANB(0U) /* phase b again, converter B */
#define CHANNEL_M1_C ADC_ANB(1U)
#define CHANNEL_M2_A ADC_ANA(4U)
#define CHANNEL_M2_B ADC_ANA(5U)
#define CHANNEL_M2_B2 ADC_ANB(4U)
#define CHANNEL_M2_C ADC_ANB(5U)
#define CHANNEL_BUS ADC_ANA(6U)
#define CHANNEL_SINK_1 ADC_ANB(6U) /* heat sink temperatures */
#define CHANNEL_SINK_2 ADC_ANB(7U)

/* ---- crossbars: VAL0 of PWMA starts PWMB; both sample events, ORed, reach the ADC ------------------------------- */

#define SYNC_SOURCE XBARA_IN_PWMA_TRIG(0U, SYNC_VAL % 2U)
#define SET_XBARA_PWMB_SYNC_0 XBARA_INPUT(XBARA_OUT_PWMB_EXT_SYNC(0U), SYNC_SOURCE)
#define SET_XBARA_PWMB_SYNC_12                                                                                         \
    (XBARA_INPUT(XBARA_OUT_PWMB_EXT_SYNC(1U), SYNC_SOURCE) | XBARA_INPUT(XBARA_OUT_PWMB_EXT_SYNC(2U), SYNC_SOURCE))

#define SAMPLE_EVENT 0U
#define SET_XBARB_SAMPLE                                                                                               \
    (XBARB_INPUT(XBARB_OUT_AOI(SAMPLE_EVENT, 0U), XBARB_IN_PWMA_TRIG01(1U)) |                                          \
     XBARB_INPUT(XBARB_OUT_AOI(SAMPLE_EVENT, 1U), XBARB_IN_PWMB_TRIG01(0U)))
#define SET_AOI_BFCRT01 /* A or B */                                                                                   \
    AOI_TERMS(AOI_TERM(AOI_PASS, AOI_1, AOI_1, AOI_1), AOI_TERM(AOI_1, AOI_PASS, AOI_1, AOI_1))
#define SET_AOI_BFCRT23 AOI_TERMS(AOI_TERM(AOI_0, AOI_0, AOI_0, AOI_0), AOI_TERM(AOI_0, AOI_0, AOI_0, AOI_0))
#define SET_XBARA_ADC                                                                                                  \
    (XBARA_INPUT(XBARA_OUT_ADCA_SYNC, XBARA_IN_AOI(SAMPLE_EVENT)) |                                                    \
     XBARA_INPUT(XBARA_OUT_ADCB_SYNC, XBARA_IN_AOI(SAMPLE_EVENT)))

/* ---- encoder timers (DRM F10): A on input 0, B on input 1 of the module ----------------------------------------- */

#define SET_TMR0_LOAD 0U
#define INPUT_A 0U
#define INPUT_B 1U
/* Counts every edge, reloads after a compare; OFLAG is the emulated index pulse (DRM F13). */
#define SET_TMR0_CTRL                                                                                                  \
    (TMR_CTRL_CM(TMR_CM_QUADRATURE) | TMR_CTRL_PCS(TMR_PCS_INPUT(INPUT_A)) | TMR_CTRL_SCS(INPUT_B) | TMR_CTRL_LENGTH | \
     TMR_CTRL_OUTMODE(TMR_OUTMODE_SET_CLEAR_SECONDARY))
#define SET_TMR2_CTRL (TMR_CTRL_CM(TMR_CM_RISING) | TMR_CTRL_PCS(TMR_PCS_OUTPUT(0U)))

#define LOG2_OF(divider)                                                                                               \
    ((divider) == 1UL    ? 0U                                                                                          \
     : (divider) == 2UL  ? 1U                                                                                          \
     : (divider) == 4UL  ? 2U                                                                                          \
     : (divider) == 8UL  ? 3U                                                                                          \
     : (divider) == 16UL ? 4U                                                                                          \
     : (divider) == 32UL ? 5U                                                                                          \
     : (divider) == 64UL ? 6U                                                                                          \
                         : 7U)
#define SET_TMR_CTRL_TIME                                                                                              \
    (TMR_CTRL_CM(TMR_CM_RISING) | TMR_CTRL_PCS(TMR_PCS_BUS(LOG2_OF(TIME_STAMP_DIVIDER))) | TMR_CTRL_SCS(INPUT_B))
#define SET_TMR_SCTRL_CAPTURE TMR_SCTRL_CAPTURE_MODE(TMR_CAPTURE_BOTH)
#define SET_TMR3_CSCTRL TMR_CSCTRL_ROC
#define ENCODER_FILTER_PERIOD (CLOCKS_OF_NS(ENCODER_FILTER_NS) / ENCODER_FILTER_SAMPLES)
#define SET_TMR_FILT (TMR_FILT_FILT_CNT(ENCODER_FILTER_SAMPLES - 3UL) | TMR_FILT_FILT_PER(ENCODER_FILTER_PERIOD))

SETTINGS_CHECK(encoder_filter_can_be_set, ENCODER_FILTER_PERIOD >= 1UL && ENCODER_FILTER_PERIOD <= 255UL);
#define GAP_TIME_STAMPS (3UL * PWM_PERIOD / 2UL / TIME_STAMP_DIVIDER) /* between two M1: one is left out */

SETTINGS_CHECK(time_stamp_divider_exists, TIME_STAMP_DIVIDER == 1UL << LOG2_OF(TIME_STAMP_DIVIDER));

/* ---- serial line ------------------------------------------------------------------------------------------------ */

#define SERIAL_CLOCK_HZ (SERIAL_CLOCK_DOUBLE ? 2UL * BUS_CLOCK_HZ : BUS_CLOCK_HZ)
#define SERIAL_RATE_OF(baud) ((SERIAL_CLOCK_HZ + (baud)) / (2UL * (baud))) /* clock / (16 x baud), 3 fraction bits */
#define SERIAL_RATE_MIN 8UL
#define SERIAL_RATE_MAX 0xFFFFUL
#define SERIAL_RATE SERIAL_RATE_OF(SERIAL_BAUD)
#define SERIAL_EXACT (2UL * SERIAL_RATE * SERIAL_BAUD) /* the clock at which the rate is exact */
#define SERIAL_DEVIATION                                                                                               \
    (SERIAL_EXACT > SERIAL_CLOCK_HZ ? SERIAL_EXACT - SERIAL_CLOCK_HZ : SERIAL_CLOCK_HZ - SERIAL_EXACT)

#define SET_SIM_PCR (SERIAL_CLOCK_DOUBLE ? SIM_PCR_SCI0_CR : 0U)
#define SERIAL_TOGETHER 3U /* bytes that raise an interrupt while more are expected */
#define SET_QSCI_RATE (QSCI_RATE_SBR(SERIAL_RATE / 8UL) | QSCI_RATE_FRAC_SBR(SERIAL_RATE % 8UL))
#define SET_QSCI_CTRL1 (QSCI_CTRL1_TE | QSCI_CTRL1_RE | QSCI_CTRL1_RFIE) /* 8 data bits, no parity, 1 stop bit */
#define SET_QSCI_CTRL2 (QSCI_CTRL2_FIFO_EN | QSCI_CTRL2_RFWM(SERIAL_TOGETHER - 1U))
#define SET_QSCI_CTRL2_REST QSCI_CTRL2_FIFO_EN /* one byte raises the interrupt */
/* Up to this rate the FIFO takes two PWM periods to fill, and M1 and M2 never last so long at a stretch. */
#define SERIAL_FETCHED_MAX (QSCI_FIFO_WORDS * 10UL * PWM_FREQUENCY_HZ / 2UL)

SETTINGS_CHECK(baud_rate_is_not_too_low, SERIAL_RATE <= SERIAL_RATE_MAX);
SETTINGS_CHECK(baud_rate_is_not_too_high, SERIAL_RATE >= SERIAL_RATE_MIN);
SETTINGS_CHECK(baud_rate_deviates_less_than_1_6_percent, SERIAL_DEVIATION <= SERIAL_CLOCK_HZ / 64UL);

/* ---- watchdog: on the internal oscillator, which outlives the crystal ------------------------------------------- */

#define WATCHDOG_COUNTS ((WATCHDOG_MS * (RC_CLOCK_HZ / 1000UL) + WATCHDOG_PRESCALER - 1UL) / WATCHDOG_PRESCALER)
#define WATCHDOG_PSS                                                                                                   \
    (WATCHDOG_PRESCALER == 1UL     ? COP_PSS_1                                                                         \
     : WATCHDOG_PRESCALER == 16UL  ? COP_PSS_16                                                                        \
     : WATCHDOG_PRESCALER == 256UL ? COP_PSS_256                                                                       \
                                   : COP_PSS_1024)
#define SET_COP_TOUT WORD(WATCHDOG_COUNTS - 1UL)
#define SET_COP_CTRL_OFF 0U
#define SET_COP_CTRL (COP_CTRL_PSS(WATCHDOG_PSS) | COP_CTRL_CLKSEL(COP_CLKSEL_RC_8MHZ) | COP_CTRL_CEN | COP_CTRL_CWP)

SETTINGS_CHECK(watchdog_time_fits, WATCHDOG_COUNTS >= 1UL && WATCHDOG_COUNTS <= 0x10000UL);

/* ---- clock gates and pins --------------------------------------------------------------------------------------- */

#define SET_SIM_PCE0                                                                                                   \
    (SIM_PCE0_GPIO(GPIO_A) | SIM_PCE0_GPIO(GPIO_B) | SIM_PCE0_GPIO(GPIO_C) | SIM_PCE0_GPIO(GPIO_D) |                   \
     SIM_PCE0_GPIO(GPIO_E) | SIM_PCE0_GPIO(GPIO_F) | SIM_PCE0_GPIO(GPIO_G) | SIM_PCE0_TA(0U) | SIM_PCE0_TA(1U) |       \
     SIM_PCE0_TA(2U) | SIM_PCE0_TA(3U) | SIM_PCE0_TB(0U) | SIM_PCE0_TB(1U) | SIM_PCE0_TB(2U) | SIM_PCE0_TB(3U))
#define SET_SIM_PCE1 SIM_PCE1_SCI0
#define SET_SIM_PCE2 SIM_PCE2_CYCADC
#define SET_SIM_PCE3                                                                                                   \
    (SIM_PCE3_PWMA(0U) | SIM_PCE3_PWMA(1U) | SIM_PCE3_PWMA(2U) | SIM_PCE3_PWMB(0U) | SIM_PCE3_PWMB(1U) |               \
     SIM_PCE3_PWMB(2U) | SIM_PCE3_PWMB(MONITOR_SM))
#define SET_SIM_IPS0 0U /* faults and encoders come straight from their pins */

/* Pin by pin; a peripheral owns a pin whose PER bit is set. JTAG on port D stays as after reset.
 *   motor 1    E0..E5 PWMA 0B 0A 1B 1A 2B 2A    E8 over-current    C3, C4 encoder A, B
 *   motor 2    G2 G3 PWMB 0B 0A, G0 G1 1B 1A, E6 E7 2B 2A    F14 over-current    C2, F8 encoder A, B
 *   host       C7 transmit, C8 receive    C0, C1 crystal
 *   monitor    G5, G4 PWMB 3A, 3B: two variables as filtered pulses
 *   resistor   G6 high switches the brake resistor on
 *   scope      F6, F7 high while M1, M2 runs (DRM F38)
 *   switches   F0 F1 F2 home, lower and upper limit of motor 1, F3 F4 F5 of motor 2: to ground, pulled up
 *   enable     E9 (PWMA FAULT1), F13 (PWMB FAULT1): to ground, pulled up
 *   holding    D5, D6 high gives the coil of the holding brake its current */
#define PIN_HOLDING(axis) BIT(5U + (axis))
#define SWITCHES_SHIFT(axis) (3U * (axis))
#define SWITCHES_MASK 7U
#define PIN_BRAKE_RESISTOR BIT(6)
#define PIN_SCOPE_M1 BIT(6)
#define PIN_SCOPE_M2 BIT(7)
#define SET_GPSAL SIM_GPSAL_A0(SIM_A0_ANA0)
#define SET_GPSCL                                                                                                      \
    (SIM_GPSCL_C0(SIM_C0_EXTAL) | SIM_GPSCL_C2(SIM_C2_TB0) | SIM_GPSCL_C3(SIM_C3_TA0) | SIM_GPSCL_C4(SIM_C4_TA1) |     \
     SIM_GPSCL_C7(SIM_C7_TXD0))
#define SET_GPSCH SIM_GPSCH_C8(SIM_C8_RXD0)
#define SET_GPSEL                                                                                                      \
    (SIM_GPSEL_E4(SIM_E4_PWMA_2B) | SIM_GPSEL_E5(SIM_E5_PWMA_2A) | SIM_GPSEL_E6(SIM_E6_PWMB_2B) |                      \
     SIM_GPSEL_E7(SIM_E7_PWMB_2A))
#define SET_GPSEH (SIM_GPSEH_E8(SIM_E8_PWMA_FAULT0) | SIM_GPSEH_E9(SIM_E9_PWMA_FAULT1))
#define SET_GPSFL 0U
#define SET_GPSFH (SIM_GPSFH_F8(SIM_F8_TB1) | SIM_GPSFH_F13(SIM_F13_PWMB_FAULT1) | SIM_GPSFH_F14(SIM_F14_PWMB_FAULT0))
#define SET_GPSGL                                                                                                      \
    (SIM_GPSGL_G0(SIM_G0_PWMB_1B) | SIM_GPSGL_G1(SIM_G1_PWMB_1A) | SIM_GPSGL_G2(SIM_G2_PWMB_0B) |                      \
     SIM_GPSGL_G3(SIM_G3_PWMB_0A) | SIM_GPSGL_G4(SIM_G4_PWMB_3B) | SIM_GPSGL_G5(SIM_G5_PWMB_3A))

#define CHANNEL_PIN(channel) BIT((channel) % 8U)
#define SET_GPIOA_PER                                                                                                  \
    (CHANNEL_PIN(CHANNEL_M1_A) | CHANNEL_PIN(CHANNEL_M1_B) | CHANNEL_PIN(CHANNEL_M2_A) | CHANNEL_PIN(CHANNEL_M2_B) |   \
     CHANNEL_PIN(CHANNEL_BUS))
#define SET_GPIOB_PER                                                                                                  \
    (CHANNEL_PIN(CHANNEL_M1_B2) | CHANNEL_PIN(CHANNEL_M1_C) | CHANNEL_PIN(CHANNEL_M2_B2) | CHANNEL_PIN(CHANNEL_M2_C) | \
     CHANNEL_PIN(CHANNEL_SINK_1) | CHANNEL_PIN(CHANNEL_SINK_2))
#define SET_GPIOC_PER (BIT(0) | BIT(1) | BIT(2) | BIT(3) | BIT(4) | BIT(7) | BIT(8))
#define SET_GPIOE_PER (BIT(0) | BIT(1) | BIT(2) | BIT(3) | BIT(4) | BIT(5) | BIT(6) | BIT(7) | BIT(8) | BIT(9))
#define SET_GPIOF_PER (BIT(8) | BIT(13) | BIT(14))
#define SET_GPIOG_PER (BIT(0) | BIT(1) | BIT(2) | BIT(3) | BIT(4) | BIT(5))
#define SET_GPIOD_DDR (PIN_HOLDING(0U) | PIN_HOLDING(1U))
#define SET_GPIOF_DDR (PIN_SCOPE_M1 | PIN_SCOPE_M2)
#define SET_GPIOG_DDR PIN_BRAKE_RESISTOR
/* Pulled up: an unplugged encoder or host is quiet, a torn over-current line is an over-current. */
#define SET_GPIOC_PULL (BIT(2) | BIT(3) | BIT(4) | BIT(8))
#define SET_GPIOE_PULL (BIT(8) | BIT(9))
#define SET_GPIOF_PULL (BIT(0) | BIT(1) | BIT(2) | BIT(3) | BIT(4) | BIT(5) | BIT(8) | BIT(13) | BIT(14))

#endif
