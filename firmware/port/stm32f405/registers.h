/* registers.h - the registers of the STM32F405 that the servo uses: addresses, offsets, fields, codes.
 *
 * Names follow RM0090. A register lies at PERIPHERAL_BASE + offset; every register is 32 bits wide. A field of one bit
 * is REGISTER_FIELD, a wider one REGISTER_FIELD(value); FIELD_GET(value, REGISTER_FIELD) takes it out again. A code,
 * that is, a value of a field, is FIELD_NAME. (n) is the number of a pin, line, stream, channel or interrupt.
 * firmware/test/test_stm32f405_registers.py looks every definition up in independent descriptions of the chip.
 */
#ifndef STM32F405_REGISTERS_H
#define STM32F405_REGISTERS_H

#include <stdint.h>

#define BIT(n) (UINT32_C(1) << (n))
#define FIELD(lsb, width, value) (((uint32_t)(value) & (BIT(width) - 1U)) << (lsb))
#define FIELD_MASK(name) name(UINT32_C(0xFFFFFFFF))
#define FIELD_GET(value, name) (((value) & FIELD_MASK(name)) / (FIELD_MASK(name) & (~FIELD_MASK(name) + 1U)))

/* ---- memories --------------------------------------------------------------------------------------------------- */

#define FLASH_MEMORY UINT32_C(0x08000000)
#define FLASH_MEMORY_SIZE UINT32_C(0x100000)
#define FLASH_SECTORS 12U
/* Sectors 0..3 of 16 kB, 4 of 64 kB, 5..11 of 128 kB. */
#define FLASH_SECTOR_SIZE(n) ((n) < 4U ? UINT32_C(0x4000) : (n) < 5U ? UINT32_C(0x10000) : UINT32_C(0x20000))
#define FLASH_SECTOR_ADDRESS(n) (FLASH_MEMORY + ((n) < 5U ? UINT32_C(0x4000) * (n) : UINT32_C(0x20000) * ((n) - 4U)))
#define SRAM1_MEMORY UINT32_C(0x20000000)
#define SRAM1_MEMORY_SIZE UINT32_C(0x1C000)
#define SRAM2_MEMORY UINT32_C(0x2001C000)
#define SRAM2_MEMORY_SIZE UINT32_C(0x4000)
#define CCM_MEMORY UINT32_C(0x10000000) /* data only: no instructions, no DMA */
#define CCM_MEMORY_SIZE UINT32_C(0x10000)

/* ---- peripherals ------------------------------------------------------------------------------------------------ */

#define TIM2_BASE UINT32_C(0x40000000)
#define TIM3_BASE UINT32_C(0x40000400)
#define TIM4_BASE UINT32_C(0x40000800)
#define TIM5_BASE UINT32_C(0x40000C00) /* of 32 bits, as TIM2 */
#define IWDG_BASE UINT32_C(0x40003000)
#define SPI3_BASE UINT32_C(0x40003C00)
#define USART2_BASE UINT32_C(0x40004400)
#define PWR_BASE UINT32_C(0x40007000)
#define TIM1_BASE UINT32_C(0x40010000)
#define TIM8_BASE UINT32_C(0x40010400)
#define ADC1_BASE UINT32_C(0x40012000)
#define ADC2_BASE UINT32_C(0x40012100)
#define ADC3_BASE UINT32_C(0x40012200)
#define ADC_COMMON_BASE UINT32_C(0x40012300)
#define SYSCFG_BASE UINT32_C(0x40013800)
#define EXTI_BASE UINT32_C(0x40013C00)
#define GPIOA_BASE UINT32_C(0x40020000)
#define GPIOB_BASE UINT32_C(0x40020400)
#define GPIOC_BASE UINT32_C(0x40020800)
#define GPIOD_BASE UINT32_C(0x40020C00)
#define RCC_BASE UINT32_C(0x40023800)
#define FLASH_BASE UINT32_C(0x40023C00)
#define DMA1_BASE UINT32_C(0x40026000)
#define DMA2_BASE UINT32_C(0x40026400)
#define DBGMCU_BASE UINT32_C(0xE0042000)
#define NVIC_BASE UINT32_C(0xE000E000)

/* ---- reset and clock control ------------------------------------------------------------------------------------ */

#define RCC_CR 0x00U
#define RCC_PLLCFGR 0x04U
#define RCC_CFGR 0x08U
#define RCC_CIR 0x0CU
#define RCC_AHB1ENR 0x30U
#define RCC_APB1ENR 0x40U
#define RCC_APB2ENR 0x44U
#define RCC_CSR 0x74U

#define RCC_CR_HSION BIT(0)
#define RCC_CR_HSIRDY BIT(1)
#define RCC_CR_HSEON BIT(16)
#define RCC_CR_HSERDY BIT(17)
#define RCC_CR_CSSON BIT(19) /* a clock failure raises the non-maskable interrupt */
#define RCC_CR_PLLON BIT(24)
#define RCC_CR_PLLRDY BIT(25)

#define RCC_PLLCFGR_PLLM(v) FIELD(0, 6, v)
#define RCC_PLLCFGR_PLLN(v) FIELD(6, 9, v)
#define RCC_PLLCFGR_PLLP(v) FIELD(16, 2, v)
#define RCC_PLLCFGR_PLLP_2 0U
#define RCC_PLLCFGR_PLLSRC BIT(22) /* 1: HSE */
#define RCC_PLLCFGR_PLLQ(v) FIELD(24, 4, v)

#define RCC_CFGR_SW(v) FIELD(0, 2, v)
#define RCC_CFGR_SW_HSI 0U
#define RCC_CFGR_SW_HSE 1U
#define RCC_CFGR_SW_PLL 2U
#define RCC_CFGR_SWS(v) FIELD(2, 2, v)
#define RCC_CFGR_SWS_PLL 2U
#define RCC_CFGR_HPRE(v) FIELD(4, 4, v)
#define RCC_CFGR_HPRE_1 0U
#define RCC_CFGR_PPRE1(v) FIELD(10, 3, v)
#define RCC_CFGR_PPRE1_1 0U
#define RCC_CFGR_PPRE1_4 5U
#define RCC_CFGR_PPRE2(v) FIELD(13, 3, v)
#define RCC_CFGR_PPRE2_1 0U
#define RCC_CFGR_PPRE2_2 4U

#define RCC_CIR_CSSF BIT(7)
#define RCC_CIR_CSSC BIT(23)

#define RCC_AHB1ENR_GPIOAEN BIT(0)
#define RCC_AHB1ENR_GPIOBEN BIT(1)
#define RCC_AHB1ENR_GPIOCEN BIT(2)
#define RCC_AHB1ENR_GPIODEN BIT(3)
#define RCC_AHB1ENR_CCMDATARAMEN BIT(20) /* set by reset */
#define RCC_AHB1ENR_DMA1EN BIT(21)
#define RCC_AHB1ENR_DMA2EN BIT(22)
#define RCC_APB1ENR_TIM2EN BIT(0)
#define RCC_APB1ENR_TIM3EN BIT(1)
#define RCC_APB1ENR_TIM4EN BIT(2)
#define RCC_APB1ENR_TIM5EN BIT(3)
#define RCC_APB1ENR_SPI3EN BIT(15)
#define RCC_APB1ENR_USART2EN BIT(17)
#define RCC_APB1ENR_PWREN BIT(28)
#define RCC_APB2ENR_TIM1EN BIT(0)
#define RCC_APB2ENR_TIM8EN BIT(1)
#define RCC_APB2ENR_ADC1EN BIT(8)
#define RCC_APB2ENR_ADC2EN BIT(9)
#define RCC_APB2ENR_ADC3EN BIT(10)
#define RCC_APB2ENR_SYSCFGEN BIT(14)

#define RCC_CSR_RMVF BIT(24) /* clears the causes of the reset */
#define RCC_CSR_WDGRSTF BIT(29)

#define PWR_CR 0x00U
#define PWR_CR_VOS BIT(14) /* 1: core voltage for 168 MHz */

/* ---- program flash ---------------------------------------------------------------------------------------------- */

#define FLASH_ACR 0x00U
#define FLASH_KEYR 0x04U
#define FLASH_SR 0x0CU
#define FLASH_CR 0x10U

#define FLASH_ACR_LATENCY(v) FIELD(0, 3, v)
#define FLASH_ACR_PRFTEN BIT(8)
#define FLASH_ACR_ICEN BIT(9)
#define FLASH_ACR_DCEN BIT(10)
#define FLASH_ACR_ICRST BIT(11)
#define FLASH_ACR_DCRST BIT(12)

#define FLASH_KEYR_1 UINT32_C(0x45670123)
#define FLASH_KEYR_2 UINT32_C(0xCDEF89AB)

#define FLASH_SR_EOP BIT(0) /* flags: write 1 to clear */
#define FLASH_SR_OPERR BIT(1)
#define FLASH_SR_WRPERR BIT(4)
#define FLASH_SR_PGAERR BIT(5)
#define FLASH_SR_PGPERR BIT(6)
#define FLASH_SR_PGSERR BIT(7)
#define FLASH_SR_BSY BIT(16)

#define FLASH_CR_PG BIT(0)
#define FLASH_CR_SER BIT(1)
#define FLASH_CR_SNB(v) FIELD(3, 4, v)
#define FLASH_CR_PSIZE(v) FIELD(8, 2, v)
#define FLASH_CR_PSIZE_32 2U
#define FLASH_CR_STRT BIT(16)
#define FLASH_CR_LOCK BIT(31)

/* ---- pins ------------------------------------------------------------------------------------------------------- */

#define GPIO_MODER 0x00U
#define GPIO_OTYPER 0x04U
#define GPIO_OSPEEDR 0x08U
#define GPIO_PUPDR 0x0CU
#define GPIO_IDR 0x10U
#define GPIO_ODR 0x14U
#define GPIO_BSRR 0x18U
#define GPIO_AFRL 0x20U
#define GPIO_AFRH 0x24U

#define GPIO_MODER_MODER(n, v) FIELD(2U * (n), 2, v)
#define GPIO_MODER_INPUT 0U
#define GPIO_MODER_OUTPUT 1U
#define GPIO_MODER_ALTERNATE 2U
#define GPIO_MODER_ANALOG 3U
#define GPIO_OSPEEDR_OSPEEDR(n, v) FIELD(2U * (n), 2, v)
#define GPIO_OSPEEDR_LOW 0U
#define GPIO_OSPEEDR_MEDIUM 1U
#define GPIO_OSPEEDR_FAST 2U
#define GPIO_PUPDR_PUPDR(n, v) FIELD(2U * (n), 2, v)
#define GPIO_PUPDR_NONE 0U
#define GPIO_PUPDR_UP 1U
#define GPIO_PUPDR_DOWN 2U
#define GPIO_IDR_IDR(n) BIT(n)
#define GPIO_ODR_ODR(n) BIT(n)
#define GPIO_BSRR_BS(n) BIT(n)
#define GPIO_BSRR_BR(n) BIT(16U + (n))
#define GPIO_AFRL_AFRL(n, v) FIELD(4U * (n), 4, v)         /* pins 0..7 */
#define GPIO_AFRH_AFRH(n, v) FIELD(4U * ((n) - 8U), 4, v) /* pins 8..15 */

/* Functions of the pins: AF_PORTn_FUNCTION is the code in AFRL or AFRH. */
#define AF_A2_USART2_TX 7U
#define AF_A3_USART2_RX 7U
#define AF_A7_TIM8_CH1N 3U
#define AF_A8_TIM1_CH1 1U
#define AF_A9_TIM1_CH2 1U
#define AF_A10_TIM1_CH3 1U
#define AF_A15_TIM2_CH1 1U
#define AF_B0_TIM8_CH2N 3U
#define AF_B1_TIM8_CH3N 3U
#define AF_B3_TIM2_CH2 1U
#define AF_B4_TIM3_CH1 2U
#define AF_B5_TIM3_CH2 2U
#define AF_B6_TIM4_CH1 2U
#define AF_B7_TIM4_CH2 2U
#define AF_B10_TIM2_CH3 1U
#define AF_B11_TIM2_CH4 1U
#define AF_B13_TIM1_CH1N 1U
#define AF_B14_TIM1_CH2N 1U
#define AF_B15_TIM1_CH3N 1U
#define AF_C6_TIM8_CH1 3U
#define AF_C7_TIM8_CH2 3U
#define AF_C8_TIM8_CH3 3U
#define AF_C10_SPI3_SCK 6U
#define AF_C11_SPI3_MISO 6U
#define AF_C12_SPI3_MOSI 6U

/* Channels of the converters: ADCx_IN_PORTn, x the converters that the pin reaches. */
#define ADC12_IN_A4 4U
#define ADC12_IN_A6 6U
#define ADC12_IN_C5 15U
#define ADC123_IN_C0 10U
#define ADC123_IN_C1 11U
#define ADC123_IN_C2 12U
#define ADC123_IN_C3 13U

/* ---- interrupt lines of the pins -------------------------------------------------------------------------------- */

/* Line n belongs to pin n of the port that its field selects: 0 is A. */
#define SYSCFG_EXTICR(n) (0x08U + 4U * ((n) / 4U))
#define SYSCFG_EXTICR_EXTI(n, v) FIELD(4U * ((n) % 4U), 4, v)
#define SYSCFG_EXTICR_A 0U
#define SYSCFG_EXTICR_B 1U
#define SYSCFG_EXTICR_C 2U
#define SYSCFG_EXTICR_D 3U

#define EXTI_IMR 0x00U
#define EXTI_RTSR 0x08U
#define EXTI_FTSR 0x0CU
#define EXTI_SWIER 0x10U
#define EXTI_PR 0x14U
#define EXTI_IMR_MR(n) BIT(n)
#define EXTI_RTSR_TR(n) BIT(n)
#define EXTI_FTSR_TR(n) BIT(n)
#define EXTI_SWIER_SWIER(n) BIT(n)
#define EXTI_PR_PR(n) BIT(n) /* write 1 to clear */

/* ---- timers ----------------------------------------------------------------------------------------------------- */

#define TIM_CR1 0x00U
#define TIM_CR2 0x04U
#define TIM_SMCR 0x08U
#define TIM_DIER 0x0CU
#define TIM_SR 0x10U
#define TIM_EGR 0x14U
#define TIM_CCMR1 0x18U
#define TIM_CCMR2 0x1CU
#define TIM_CCER 0x20U
#define TIM_CNT 0x24U
#define TIM_PSC 0x28U
#define TIM_ARR 0x2CU
#define TIM_RCR 0x30U
#define TIM_CCR1 0x34U
#define TIM_CCR2 0x38U
#define TIM_CCR3 0x3CU
#define TIM_CCR4 0x40U
#define TIM_BDTR 0x44U

#define TIM_CR1_CEN BIT(0)
#define TIM_CR1_UDIS BIT(1)
#define TIM_CR1_URS BIT(2)
#define TIM_CR1_DIR BIT(4) /* 1: counts down */
#define TIM_CR1_CMS(v) FIELD(5, 2, v)
#define TIM_CR1_CMS_CENTRE_3 3U
#define TIM_CR1_ARPE BIT(7)
#define TIM_CR1_CKD(v) FIELD(8, 2, v)

#define TIM_CR2_MMS(v) FIELD(4, 3, v)
#define TIM_CR2_MMS_RESET 0U
#define TIM_CR2_MMS_ENABLE 1U
#define TIM_CR2_MMS_UPDATE 2U
#define TIM_CR2_MMS_OC4REF 7U
#define TIM_CR2_OIS1 BIT(8)
#define TIM_CR2_OIS1N BIT(9)
#define TIM_CR2_OIS2 BIT(10)
#define TIM_CR2_OIS2N BIT(11)
#define TIM_CR2_OIS3 BIT(12)
#define TIM_CR2_OIS3N BIT(13)

#define TIM_SMCR_SMS(v) FIELD(0, 3, v)
#define TIM_SMCR_SMS_OFF 0U
#define TIM_SMCR_SMS_ENCODER_3 3U
#define TIM_SMCR_SMS_TRIGGER 6U
#define TIM_SMCR_TS(v) FIELD(4, 3, v)
#define TIM_SMCR_TS_ITR0 0U /* of TIM8: TIM1 */
#define TIM_SMCR_MSM BIT(7)

#define TIM_SR_UIF BIT(0) /* flags: write 0 to clear */
#define TIM_EGR_UG BIT(0)

#define TIM_CCMR1_CC1S(v) FIELD(0, 2, v)
#define TIM_CCMR1_CC1S_TI1 1U
#define TIM_CCMR1_CC2S(v) FIELD(8, 2, v)
#define TIM_CCMR1_CC2S_TI2 1U
#define TIM_CCMR1_IC1F(v) FIELD(4, 4, v)
#define TIM_CCMR1_IC2F(v) FIELD(12, 4, v)
#define TIM_CCMR1_OC1PE BIT(3)
#define TIM_CCMR1_OC1M(v) FIELD(4, 3, v)
#define TIM_CCMR1_OC1M_PWM1 6U
#define TIM_CCMR1_OC1M_PWM2 7U
#define TIM_CCMR1_OC2PE BIT(11)
#define TIM_CCMR1_OC2M(v) FIELD(12, 3, v)
#define TIM_CCMR2_OC3PE BIT(3)
#define TIM_CCMR2_OC3M(v) FIELD(4, 3, v)
#define TIM_CCMR2_OC4PE BIT(11)
#define TIM_CCMR2_OC4M(v) FIELD(12, 3, v)

#define TIM_CCER_CC1E BIT(0)
#define TIM_CCER_CC1P BIT(1)
#define TIM_CCER_CC1NE BIT(2)
#define TIM_CCER_CC1NP BIT(3)
#define TIM_CCER_CC2E BIT(4)
#define TIM_CCER_CC2P BIT(5)
#define TIM_CCER_CC2NE BIT(6)
#define TIM_CCER_CC2NP BIT(7)
#define TIM_CCER_CC3E BIT(8)
#define TIM_CCER_CC3P BIT(9)
#define TIM_CCER_CC3NE BIT(10)
#define TIM_CCER_CC3NP BIT(11)
#define TIM_CCER_CC4E BIT(12)
#define TIM_CCER_CC4P BIT(13)

#define TIM_RCR_REP(v) FIELD(0, 8, v)

/* Dead time: below 128 in clocks; codes from 0x80 in steps of 2, 8 and 16 clocks. */
#define TIM_BDTR_DTG(v) FIELD(0, 8, v)
#define TIM_BDTR_LOCK(v) FIELD(8, 2, v)
#define TIM_BDTR_OSSI BIT(10)
#define TIM_BDTR_OSSR BIT(11)
#define TIM_BDTR_BKE BIT(12)
#define TIM_BDTR_BKP BIT(13)
#define TIM_BDTR_AOE BIT(14)
#define TIM_BDTR_MOE BIT(15)

/* ---- analogue to digital converters ----------------------------------------------------------------------------- */

#define ADC_SR 0x00U
#define ADC_CR1 0x04U
#define ADC_CR2 0x08U
#define ADC_SMPR1 0x0CU
#define ADC_SMPR2 0x10U
#define ADC_HTR 0x24U
#define ADC_LTR 0x28U
#define ADC_SQR1 0x2CU
#define ADC_SQR2 0x30U
#define ADC_SQR3 0x34U
#define ADC_JSQR 0x38U
#define ADC_JDR1 0x3CU
#define ADC_JDR2 0x40U
#define ADC_JDR3 0x44U
#define ADC_JDR4 0x48U
#define ADC_DR 0x4CU

#define ADC_SR_AWD BIT(0) /* flags: write 0 to clear */
#define ADC_SR_EOC BIT(1)
#define ADC_SR_JEOC BIT(2)
#define ADC_SR_JSTRT BIT(3)
#define ADC_SR_STRT BIT(4)
#define ADC_SR_OVR BIT(5)

#define ADC_CR1_EOCIE BIT(5)
#define ADC_CR1_JEOCIE BIT(7)
#define ADC_CR1_SCAN BIT(8)
#define ADC_CR1_RES(v) FIELD(24, 2, v)
#define ADC_CR1_OVRIE BIT(26)

#define ADC_CR2_ADON BIT(0)
#define ADC_CR2_CONT BIT(1)
#define ADC_CR2_DMA BIT(8)
#define ADC_CR2_DDS BIT(9) /* DMA requests go on behind the last transfer */
#define ADC_CR2_EOCS BIT(10)
#define ADC_CR2_ALIGN BIT(11)
#define ADC_CR2_JEXTSEL(v) FIELD(16, 4, v)
#define ADC_CR2_JEXTSEL_TIM1_TRGO 1U
#define ADC_CR2_JEXTEN(v) FIELD(20, 2, v)
#define ADC_CR2_JEXTEN_RISING 1U
#define ADC_CR2_EXTSEL(v) FIELD(24, 4, v)
#define ADC_CR2_EXTSEL_TIM8_TRGO 14U
#define ADC_CR2_EXTEN(v) FIELD(28, 2, v)
#define ADC_CR2_EXTEN_RISING 1U

/* Sample times, three bits to a channel: SMPR2 channels 0..9, SMPR1 channels 10..18; the same codes in both. */
#define ADC_SMPR1_SMP(n, v) FIELD(3U * ((n) - 10U), 3, v)
#define ADC_SMPR2_SMP(n, v) FIELD(3U * (n), 3, v)
#define ADC_SMPR1_SMP_3_CLOCKS 0U
#define ADC_SMPR1_SMP_15_CLOCKS 1U
#define ADC_SMPR1_SMP_28_CLOCKS 2U
#define ADC_SMPR1_SMP_480_CLOCKS 7U

#define ADC_SQR1_L(v) FIELD(20, 4, v) /* conversions - 1 */
#define ADC_SQR3_SQ1(v) FIELD(0, 5, v)
#define ADC_SQR3_SQ2(v) FIELD(5, 5, v)
#define ADC_JSQR_JSQ1(v) FIELD(0, 5, v) /* a sequence of k conversions begins with JSQ(5 - k) */
#define ADC_JSQR_JSQ2(v) FIELD(5, 5, v)
#define ADC_JSQR_JSQ3(v) FIELD(10, 5, v)
#define ADC_JSQR_JSQ4(v) FIELD(15, 5, v)
#define ADC_JSQR_JL(v) FIELD(20, 2, v)

#define ADC_COMMON_CSR 0x00U
#define ADC_COMMON_CCR 0x04U
#define ADC_COMMON_CCR_ADCPRE(v) FIELD(16, 2, v)
#define ADC_COMMON_CCR_ADCPRE_4 1U

/* ---- DMA -------------------------------------------------------------------------------------------------------- */

/* Flags of stream n in DMA_ISR(n); DMA_IFCR(n) clears them by 1. */
#define DMA_ISR(n) (4U * ((n) / 4U))
#define DMA_IFCR(n) (8U + 4U * ((n) / 4U))
#define DMA_FLAG(n) (6U * ((n) % 4U) + 4U * ((n) % 4U / 2U))
#define DMA_ISR_FEIF(n) BIT(DMA_FLAG(n))
#define DMA_ISR_DMEIF(n) BIT(DMA_FLAG(n) + 2U)
#define DMA_ISR_TEIF(n) BIT(DMA_FLAG(n) + 3U)
#define DMA_ISR_HTIF(n) BIT(DMA_FLAG(n) + 4U)
#define DMA_ISR_TCIF(n) BIT(DMA_FLAG(n) + 5U)
#define DMA_ISR_ALL(n) (DMA_ISR_FEIF(n) | DMA_ISR_DMEIF(n) | DMA_ISR_TEIF(n) | DMA_ISR_HTIF(n) | DMA_ISR_TCIF(n))

#define DMA_SCR(n) (0x10U + 0x18U * (n))
#define DMA_SNDTR(n) (0x14U + 0x18U * (n))
#define DMA_SPAR(n) (0x18U + 0x18U * (n))
#define DMA_SM0AR(n) (0x1CU + 0x18U * (n))
#define DMA_SFCR(n) (0x24U + 0x18U * (n))

#define DMA_SCR_EN BIT(0)
#define DMA_SCR_TCIE BIT(4)
#define DMA_SCR_DIR(v) FIELD(6, 2, v)
#define DMA_SCR_DIR_TO_MEMORY 0U
#define DMA_SCR_DIR_TO_PERIPHERAL 1U
#define DMA_SCR_CIRC BIT(8)
#define DMA_SCR_MINC BIT(10)
#define DMA_SCR_PSIZE(v) FIELD(11, 2, v)
#define DMA_SCR_PSIZE_8 0U
#define DMA_SCR_PSIZE_16 1U
#define DMA_SCR_MSIZE(v) FIELD(13, 2, v)
#define DMA_SCR_MSIZE_8 0U
#define DMA_SCR_MSIZE_16 1U
#define DMA_SCR_PL(v) FIELD(16, 2, v)
#define DMA_SCR_PL_HIGH 2U
#define DMA_SCR_CHSEL(v) FIELD(25, 3, v)

/* Channel codes: DMAx_Sn_REQUEST. */
#define DMA1_S5_USART2_RX 4U
#define DMA1_S6_USART2_TX 4U
#define DMA2_S0_ADC3 2U
#define DMA2_S2_ADC2 1U

/* ---- serial interface ------------------------------------------------------------------------------------------- */

#define USART_SR 0x00U
#define USART_DR 0x04U
#define USART_BRR 0x08U
#define USART_CR1 0x0CU
#define USART_CR2 0x10U
#define USART_CR3 0x14U

#define USART_SR_PE BIT(0)
#define USART_SR_FE BIT(1)
#define USART_SR_NF BIT(2)
#define USART_SR_ORE BIT(3) /* flags of errors: cleared by reading SR, then DR */
#define USART_SR_RXNE BIT(5)
#define USART_SR_TC BIT(6)
#define USART_SR_TXE BIT(7)

#define USART_CR1_RE BIT(2)
#define USART_CR1_TE BIT(3)
#define USART_CR1_UE BIT(13)
#define USART_CR3_DMAR BIT(6)
#define USART_CR3_DMAT BIT(7)

/* ---- SPI -------------------------------------------------------------------------------------------------------- */

#define SPI_CR1 0x00U
#define SPI_CR2 0x04U
#define SPI_SR 0x08U
#define SPI_DR 0x0CU

#define SPI_CR1_CPHA BIT(0)
#define SPI_CR1_CPOL BIT(1)
#define SPI_CR1_MSTR BIT(2)
#define SPI_CR1_BR(v) FIELD(3, 3, v)
#define SPI_CR1_BR_16 3U
#define SPI_CR1_SPE BIT(6)
#define SPI_CR1_SSI BIT(8)
#define SPI_CR1_SSM BIT(9)
#define SPI_CR1_DFF BIT(11) /* 16 bits */

#define SPI_SR_RXNE BIT(0)
#define SPI_SR_TXE BIT(1)
#define SPI_SR_OVR BIT(6)
#define SPI_SR_BSY BIT(7)

/* ---- watchdog --------------------------------------------------------------------------------------------------- */

#define IWDG_KR 0x00U
#define IWDG_PR 0x04U
#define IWDG_RLR 0x08U
#define IWDG_SR 0x0CU
#define IWDG_KR_SERVICE 0xAAAAU
#define IWDG_KR_UNLOCK 0x5555U
#define IWDG_KR_START 0xCCCCU
#define IWDG_PR_PR(v) FIELD(0, 3, v)
#define IWDG_PR_PR_4 0U
#define IWDG_RLR_RL(v) FIELD(0, 12, v)
#define IWDG_SR_PVU BIT(0)
#define IWDG_SR_RVU BIT(1)

/* ---- core ------------------------------------------------------------------------------------------------------- */

#define DBGMCU_APB1_FZ 0x08U
#define DBGMCU_APB2_FZ 0x0CU
#define DBGMCU_APB1_FZ_TIM5 BIT(3) /* stop while the debugger holds the core */
#define DBGMCU_APB1_FZ_IWDG BIT(12)
#define DBGMCU_APB2_FZ_TIM1 BIT(0)
#define DBGMCU_APB2_FZ_TIM8 BIT(1)

#define NVIC_ISER(n) (0x100U + 4U * ((n) / 32U))
#define NVIC_ICER(n) (0x180U + 4U * ((n) / 32U))
#define NVIC_ISPR(n) (0x200U + 4U * ((n) / 32U))
#define NVIC_ICPR(n) (0x280U + 4U * ((n) / 32U))
#define NVIC_IPR(n) (0x400U + 4U * ((n) / 4U))
#define NVIC_IRQ(n) BIT((n) % 32U)
#define NVIC_IPR_IPR(n, v) FIELD(8U * ((n) % 4U), 8, v)
#define NVIC_PRIORITY_BITS 4U /* the upper ones of the eight */

#define SCB_VTOR UINT32_C(0xE000ED08)

#define IRQ_EXTI0 6U
#define IRQ_EXTI1 7U
#define IRQ_EXTI2 8U
#define IRQ_ADC 18U
#define IRQ_EXTI9_5 23U
#define IRQ_EXTI15_10 40U
#define IRQ_DMA2_STREAM2 58U
#define IRQS 82U

#endif
