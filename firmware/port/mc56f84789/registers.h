/* registers.h - the registers of the MC56F84789 that the servo uses: word addresses, fields, codes.
 *
 * Names are those of the chip's own headers. A register of a repeated block is base + offset; a field of more than one
 * bit is FIELD_NAME(value), FIELD_GET(register, FIELD_NAME_MASK) takes it out again.
 */
#ifndef PORT_REGISTERS_H
#define PORT_REGISTERS_H

#include <stdint.h>

#define BIT(n) ((uint16_t)(1U << (n)))
#define FIELD(lsb, value) ((uint16_t)((unsigned)(value) << (lsb)))
#define FIELD_GET(value, mask) ((uint16_t)(((unsigned)(value) & (mask)) / ((mask) & (~(unsigned)(mask) + 1U))))

/* ---- eFlexPWM: submodule n of a module at base + PWM_SM(n) ------------------------------------------------------ */

#define PWMA_BASE 0xE600U
#define PWMB_BASE 0xE700U
#define PWM_SUBMODULES 4U
#define PWM_SM(n) (0x30U * (n))

#define PWM_CNT 0x00U
#define PWM_INIT 0x01U
#define PWM_CTRL2 0x02U
#define PWM_CTRL 0x03U
#define PWM_VAL0 0x05U
#define PWM_VAL1 0x07U
#define PWM_VAL2 0x09U
#define PWM_VAL3 0x0BU
#define PWM_VAL4 0x0DU
#define PWM_VAL5 0x0FU
#define PWM_FRCTRL 0x10U
#define PWM_OCTRL 0x11U
#define PWM_STS 0x12U
#define PWM_INTEN 0x13U
#define PWM_TCTRL 0x15U
#define PWM_DISMAP0 0x16U
#define PWM_DISMAP1 0x17U
#define PWM_DTCNT0 0x18U
#define PWM_DTCNT1 0x19U

#define PWM_CTRL2_RELOAD_SEL BIT(2) /* reload with submodule 0 */
#define PWM_CTRL2_FORCE BIT(6)
#define PWM_CTRL2_INIT_SEL(v) FIELD(8, v)
#define PWM_CTRL2_INDEP BIT(13)

#define PWM_INIT_SEL_LOCAL_SYNC 0U
#define PWM_INIT_SEL_MASTER_SYNC 2U
#define PWM_INIT_SEL_EXT_SYNC 3U

#define PWM_CTRL_LDMOD BIT(2)
#define PWM_CTRL_FULL BIT(10)
#define PWM_CTRL_HALF BIT(11)

#define PWM_OCTRL_PWMBFS(v) FIELD(2, v)
#define PWM_OCTRL_PWMAFS(v) FIELD(4, v)
#define PWM_FAULT_STATE_LOW 0U

/* STS (flags, write 1 to clear) and INTEN have the same layout. */
#define PWM_STS_CMPF(k) BIT(k) /* the counter has matched VALk */
#define PWM_INTEN_CMPIE(k) BIT(k)

#define PWM_TCTRL_OUT_TRIG_EN(k) BIT(k) /* even k: OUT_TRIG0, odd k: OUT_TRIG1 */

/* One bit per fault, 0-3 in DISMAP0 and 4-7 in DISMAP1. */
#define PWM_DISMAP_A(v) FIELD(0, v)
#define PWM_DISMAP_B(v) FIELD(4, v)
#define PWM_DISMAP_X_MASK FIELD(8, 15)
#define PWM_DISMAP_ONES FIELD(12, 15) /* unused bits that reset to 1 */

#define PWM_DTCNT_MASK FIELD(0, 0x7FF)

/* Registers of the module. */
#define PWM_OUTEN 0xC0U
#define PWM_MASK 0xC1U
#define PWM_DTSRCSEL 0xC3U
#define PWM_MCTRL 0xC4U
#define PWM_FCTRL0 0xC6U
#define PWM_FSTS0 0xC7U
#define PWM_FFILT0 0xC8U

/* OUTEN, MASK and MCTRL have one bit per submodule in each field. */
#define PWM_OUTEN_B(v) FIELD(4, v)
#define PWM_OUTEN_A(v) FIELD(8, v)

#define PWM_MCTRL_LDOK(v) FIELD(0, v)
#define PWM_MCTRL_LDOK_MASK FIELD(0, 15)
#define PWM_MCTRL_CLDOK(v) FIELD(4, v)
#define PWM_MCTRL_CLDOK_MASK FIELD(4, 15)
#define PWM_MCTRL_RUN(v) FIELD(8, v)
#define PWM_MCTRL_RUN_MASK FIELD(8, 15)

/* One bit per fault 0-3 in each field. */
#define PWM_FCTRL_FIE(v) FIELD(0, v)
#define PWM_FCTRL_FSAFE(v) FIELD(4, v)
#define PWM_FCTRL_FLVL(v) FIELD(12, v) /* 1: a high level is a fault */

#define PWM_FSTS_FFLAG(v) FIELD(0, v) /* write 1 to clear */
#define PWM_FSTS_FFLAG_MASK FIELD(0, 15)
#define PWM_FSTS_FFULL(v) FIELD(4, v)
#define PWM_FSTS_FFPIN(v) FIELD(8, v)

#define PWM_FFILT_FILT_PER(v) FIELD(0, v)
#define PWM_FFILT_FILT_CNT(v) FIELD(8, v)

/* ---- 12-bit cyclic ADC ------------------------------------------------------------------------------------------ */

#define ADC_BASE 0xE500U
#define ADC_SAMPLES 16U
#define ADC_CTRL1 0xE500U
#define ADC_CTRL2 0xE501U
#define ADC_ZXCTRL1 0xE502U
#define ADC_ZXCTRL2 0xE503U
#define ADC_CLIST(n) (0xE504U + (n)) /* CLIST1..4: samples 4n .. 4n+3 */
#define ADC_SDIS 0xE508U
#define ADC_STAT 0xE509U
#define ADC_RDY 0xE50AU
#define ADC_RSLT(n) (0xE50EU + (n))
#define ADC_OFFST(n) (0xE53EU + (n))
#define ADC_PWR 0xE54EU
#define ADC_CAL 0xE54FU
#define ADC_GC1 0xE550U
#define ADC_GC2 0xE551U
#define ADC_SCTRL 0xE552U
#define ADC_PWR2 0xE553U
#define ADC_CTRL3 0xE554U
#define ADC_SCHLTEN 0xE555U

#define ADC_CTRL1_SMODE(v) FIELD(0, v)
#define ADC_SMODE_TRIGGERED_PARALLEL 5U
#define ADC_CTRL1_EOSIE0 BIT(11)
#define ADC_CTRL1_SYNC0 BIT(12)
#define ADC_CTRL1_STOP0 BIT(14)

#define ADC_CTRL2_DIV0(v) FIELD(0, v)
#define ADC_CTRL2_SIMULT BIT(6)
#define ADC_CTRL2_STOP1 BIT(14)

/* Channel lists: four samples of four bits; codes 0-7 ANA0-7, 8-15 ANB0-7. */
#define ADC_CLIST_SAMPLE(n, channel) FIELD(4U * ((n) % 4U), channel)
#define ADC_ANA(n) (n)
#define ADC_ANB(n) (8U + (n))

#define ADC_STAT_EOSI0 BIT(11) /* write 1 to clear */
#define ADC_STAT_EOSI1 BIT(12)

#define ADC_RSLT_SHIFT 3 /* a result stands in bits 14:3 */
#define ADC_RSLT_MASK FIELD(ADC_RSLT_SHIFT, 0xFFF)

#define ADC_PWR_PD0 BIT(0)
#define ADC_PWR_PD1 BIT(1)
#define ADC_PWR_PSTS0 BIT(10) /* still powered down */
#define ADC_PWR_PSTS1 BIT(11)

#define ADC_PWR2_SPEEDA(v) FIELD(0, v)
#define ADC_PWR2_SPEEDB(v) FIELD(2, v)
#define ADC_PWR2_DIV1(v) FIELD(8, v)

/* ---- quad timers: channel n of a module at base + TMR_CHANNEL(n) ------------------------------------------------ */

#define TMRA_BASE 0xE140U
#define TMRB_BASE 0xE180U
#define TMR_CHANNELS 4U
#define TMR_CHANNEL(n) (0x10U * (n))

#define TMR_COMP1 0x0U
#define TMR_COMP2 0x1U
#define TMR_CAPT 0x2U
#define TMR_LOAD 0x3U
#define TMR_CNTR 0x5U
#define TMR_CTRL 0x6U
#define TMR_SCTRL 0x7U
#define TMR_CSCTRL 0xAU
#define TMR_FILT 0xBU
#define TMR_ENBL 0xFU /* channel 0 only */

#define TMR_CTRL_OUTMODE(v) FIELD(0, v)
#define TMR_OUTMODE_SET_CLEAR_SECONDARY 5U
#define TMR_CTRL_LENGTH BIT(5)
#define TMR_CTRL_SCS(v) FIELD(7, v)
#define TMR_CTRL_PCS(v) FIELD(9, v)
#define TMR_PCS_INPUT(n) (n)
#define TMR_PCS_OUTPUT(n) (4U + (n))
#define TMR_PCS_BUS(log2_divider) (8U + (log2_divider))
#define TMR_CTRL_CM(v) FIELD(13, v)
#define TMR_CM_RISING 1U
#define TMR_CM_QUADRATURE 4U

#define TMR_SCTRL_CAPTURE_MODE(v) FIELD(6, v)
#define TMR_SCTRL_CAPTURE_MODE_MASK FIELD(6, 3)
#define TMR_CAPTURE_BOTH 3U
#define TMR_SCTRL_IEFIE BIT(10)
#define TMR_SCTRL_IEF BIT(11) /* flags: write 0 to clear */
#define TMR_SCTRL_TOF BIT(13)
#define TMR_SCTRL_TCF BIT(15)

#define TMR_CSCTRL_ROC BIT(11)

#define TMR_FILT_FILT_PER(v) FIELD(0, v)
#define TMR_FILT_FILT_CNT(v) FIELD(8, v)

#define TMR_ENBL_MASK FIELD(0, 15)

/* ---- crossbars and AND-OR-invert -------------------------------------------------------------------------------- */

/* SELk holds the inputs of two outputs: 2k in the low byte, 2k + 1 in the high byte. */
#define XBARA_BASE 0xE340U
#define XBARA_SEL(output) (XBARA_BASE + (output) / 2U)
#define XBARA_INPUT(output, input) FIELD(8U * ((output) % 2U), input)

#define XBARA_IN_PWMA_TRIG(sm, trig) (20U + 2U * (sm) + (trig))
#define XBARA_IN_AOI(event) (46U + (event))

#define XBARA_OUT_ADCA_SYNC 12U
#define XBARA_OUT_ADCB_SYNC 13U
#define XBARA_OUT_PWMB_EXT_SYNC(sm) (53U + (sm))

#define XBARB_BASE 0xE360U
#define XBARB_SEL(output) (XBARB_BASE + (output) / 2U)
#define XBARB_INPUT(output, input) FIELD(8U * ((output) % 2U), input)

#define XBARB_IN_PWMA_TRIG01(sm) (8U + (sm))
#define XBARB_IN_PWMB_TRIG01(sm) (22U + (sm))
#define XBARB_OUT_AOI(event, input) (4U * (event) + (input)) /* input 0-3 is A-D */

#define AOI_BASE 0xE380U
#define AOI_EVENTS 4U
#define AOI_BFCRT01(event) (AOI_BASE + 2U * (event))
#define AOI_BFCRT23(event) (AOI_BASE + 2U * (event) + 1U)
#define AOI_TERM(a, b, c, d) FIELD(0, ((a) << 6) | ((b) << 4) | ((c) << 2) | (d))
#define AOI_TERMS(even, odd) FIELD(0, ((unsigned)(even) << 8) | (odd)) /* even: term 0 or 2 */
#define AOI_0 0U
#define AOI_PASS 1U
#define AOI_1 3U

/* ---- serial interfaces ------------------------------------------------------------------------------------------ */

#define QSCI0_BASE 0xE080U
#define QSCI_RATE 0U
#define QSCI_CTRL1 1U
#define QSCI_CTRL2 2U
#define QSCI_STAT 3U
#define QSCI_DATA 4U
#define QSCI_CTRL3 5U

#define QSCI_RATE_SBR(v) FIELD(3, v)
#define QSCI_RATE_FRAC_SBR(v) FIELD(0, v) /* eighths */

#define QSCI_CTRL1_RE BIT(2)
#define QSCI_CTRL1_TE BIT(3)
#define QSCI_CTRL1_RFIE BIT(5)

#define QSCI_CTRL2_FIFO_EN BIT(5)
#define QSCI_CTRL2_RFWM(v) FIELD(6, v) /* v + 1 words */
#define QSCI_CTRL2_RFCNT_MASK FIELD(8, 7)
#define QSCI_CTRL2_TFCNT_MASK FIELD(13, 7)
#define QSCI_FIFO_WORDS 4U

#define QSCI_STAT_PF BIT(8)
#define QSCI_STAT_FE BIT(9)
#define QSCI_STAT_NF BIT(10)
#define QSCI_STAT_OR BIT(11)

/* ---- flash controller: registers of bytes, two in a word, the even one in its low half ----------------------------- */

#define DATA_FLASH_BASE 0x8000U /* in words of 16 bits */
#define DATA_FLASH_SECTORS 32U  /* sectors of 1 KB */

#define FTFL_STAT 0xE3C0U          /* FSTAT, FCNFG */
#define FTFL_FCCOB_ADDRESS 0xE3C2U /* FCCOB3, 2: bits 15:0 of the address, which counts bytes */
#define FTFL_FCCOB_COMMAND 0xE3C3U /* FCCOB1, 0: bits 23:16, and the command */
#define FTFL_FCCOB_LOW 0xE3C4U     /* FCCOB7, 6: bits 15:0 of the value */
#define FTFL_FCCOB_HIGH 0xE3C5U    /* FCCOB5, 4 */

#define FTFL_STAT_MGSTAT0 BIT(0)
#define FTFL_STAT_FPVIOL BIT(4)
#define FTFL_STAT_ACCERR BIT(5)
#define FTFL_STAT_RDCOLERR BIT(6)
#define FTFL_STAT_CCIF BIT(7) /* done; write 1 to begin the next command */
#define FTFL_STAT_ERRORS (FTFL_STAT_FPVIOL | FTFL_STAT_ACCERR | FTFL_STAT_RDCOLERR) /* write 1 to clear */

#define FTFL_COMMAND(v) FIELD(8, v)
#define FTFL_ADDRESS_DATA BIT(7) /* bit 23 of the address: data flash, from its beginning */
#define FTFL_PROGRAM_LONGWORD 0x06U
#define FTFL_ERASE_SECTOR 0x09U

/* ---- clock ------------------------------------------------------------------------------------------------------ */

#define OCCS_CTRL 0xE2B0U
#define OCCS_DIVBY 0xE2B1U
#define OCCS_STAT 0xE2B2U
#define OCCS_OSCTL1 0xE2B4U
#define OCCS_OSCTL2 0xE2B5U
#define OCCS_PROT 0xE2B8U

#define OCCS_CTRL_ZSRC BIT(0) /* 1: PLL / 2 */
#define OCCS_CTRL_PRECS(v) FIELD(2, v)
#define OCCS_PRECS_INTERNAL 0U
#define OCCS_PRECS_EXTERNAL 1U
#define OCCS_CTRL_PLLPD BIT(4)
#define OCCS_CTRL_LCKON BIT(7)

#define OCCS_DIVBY_PLLDB(v) FIELD(0, v)
#define OCCS_DIVBY_COD(v) FIELD(8, v)
#define OCCS_DIVBY_LORTP(v) FIELD(12, v)

#define OCCS_STAT_ZSRCS(v) FIELD(0, v)
#define OCCS_STAT_ZSRCS_MASK FIELD(0, 3)
#define OCCS_ZSRCS_OSCILLATOR 0U
#define OCCS_ZSRCS_PLL 1U
#define OCCS_STAT_LCK0 BIT(5)
#define OCCS_STAT_LCK1 BIT(6)
#define OCCS_STAT_OSC_OK BIT(7)

#define OCCS_OSCTL1_FREQ_TRIM8M(v) FIELD(0, v)
#define OCCS_OSCTL1_FREQ_TRIM8M_MASK FIELD(0, 0x3FF)
#define OCCS_OSCTL1_EXT_SEL BIT(10)
#define OCCS_OSCTL1_CLK_MODE BIT(12)
#define OCCS_OSCTL1_ROPD BIT(15)

#define OCCS_OSCTL2_TEMP_TRIM8M(v) FIELD(10, v)
#define OCCS_OSCTL2_TEMP_TRIM8M_MASK FIELD(10, 15)
#define OCCS_OSCTL2_COPD BIT(14)

/* ---- watchdog --------------------------------------------------------------------------------------------------- */

#define COP_CTRL 0xE320U
#define COP_TOUT 0xE321U
#define COP_CNTR 0xE322U

#define COP_CTRL_CWP BIT(0)
#define COP_CTRL_CEN BIT(1)
#define COP_CTRL_CLKSEL(v) FIELD(5, v)
#define COP_CLKSEL_RC_8MHZ 0U
#define COP_CTRL_PSS(v) FIELD(8, v)
#define COP_PSS_1 0U
#define COP_PSS_16 1U
#define COP_PSS_256 2U
#define COP_PSS_1024 3U
#define COP_SERVICE_1 0x5555U
#define COP_SERVICE_2 0xAAAAU

/* ---- system integration ----------------------------------------------------------------------------------------- */

#define SIM_CTRL 0xE400U
#define SIM_RSTAT 0xE401U
#define SIM_PCR 0xE40BU
#define SIM_PCE0 0xE40CU
#define SIM_PCE1 0xE40DU
#define SIM_PCE2 0xE40EU
#define SIM_PCE3 0xE40FU
#define SIM_PROT 0xE416U
#define SIM_GPSAL 0xE417U
#define SIM_GPSCL 0xE419U
#define SIM_GPSCH 0xE41AU
#define SIM_GPSEL 0xE41CU
#define SIM_GPSEH 0xE41DU
#define SIM_GPSFL 0xE41EU
#define SIM_GPSFH 0xE41FU
#define SIM_GPSGL 0xE420U
#define SIM_GPSGH 0xE421U
#define SIM_IPS0 0xE422U
#define SIM_PWRMODE 0xE428U
#define SIM_NVMOPT2H 0xE42CU

#define SIM_RSTAT_COP_LOR BIT(4)
#define SIM_RSTAT_COP_CPU BIT(5)

#define SIM_PCR_SCI0_CR BIT(13)

#define SIM_PCE0_GPIO(port) BIT(6U - (port)) /* port 0-6 is A-G */
#define SIM_PCE0_TB(n) BIT(11U - (n))
#define SIM_PCE0_TA(n) BIT(15U - (n))
#define SIM_PCE1_SCI0 BIT(12)
#define SIM_PCE2_CYCADC BIT(7)
#define SIM_PCE3_PWMB(sm) BIT(3U - (sm))
#define SIM_PCE3_PWMA(sm) BIT(7U - (sm))

#define SIM_NVMOPT2H_FREQ_TRIM8M_MASK FIELD(0, 0x3FF)
#define SIM_NVMOPT2H_TEMP_TRIM8M_MASK FIELD(10, 15)

/* Functions of the pins that the board uses; 0 where this file has no name. */
#define SIM_GPSAL_A0(v) FIELD(0, v)
#define SIM_GPSCL_C0(v) FIELD(0, v)
#define SIM_GPSCL_C2(v) FIELD(4, v)
#define SIM_GPSCL_C3(v) FIELD(6, v)
#define SIM_GPSCL_C4(v) FIELD(8, v)
#define SIM_GPSCL_C7(v) FIELD(14, v)
#define SIM_GPSCH_C8(v) FIELD(0, v)
#define SIM_GPSEL_E4(v) FIELD(8, v)
#define SIM_GPSEL_E5(v) FIELD(10, v)
#define SIM_GPSEL_E6(v) FIELD(12, v)
#define SIM_GPSEL_E7(v) FIELD(14, v)
#define SIM_GPSEH_E8(v) FIELD(0, v)
#define SIM_GPSEH_E9(v) FIELD(2, v)
#define SIM_GPSFH_F8(v) FIELD(0, v)
#define SIM_GPSFH_F13(v) FIELD(10, v)
#define SIM_GPSFH_F14(v) FIELD(12, v)
#define SIM_GPSGL_G0(v) FIELD(0, v)
#define SIM_GPSGL_G1(v) FIELD(2, v)
#define SIM_GPSGL_G2(v) FIELD(4, v)
#define SIM_GPSGL_G3(v) FIELD(6, v)
#define SIM_GPSGL_G4(v) FIELD(8, v)
#define SIM_GPSGL_G5(v) FIELD(10, v)
#define SIM_A0_ANA0 0U
#define SIM_C0_EXTAL 0U
#define SIM_C2_TB0 1U
#define SIM_C3_TA0 0U
#define SIM_C4_TA1 0U
#define SIM_C7_TXD0 1U
#define SIM_C8_RXD0 1U
#define SIM_E4_PWMA_2B 0U
#define SIM_E5_PWMA_2A 0U
#define SIM_E6_PWMB_2B 2U
#define SIM_E7_PWMB_2A 2U
#define SIM_E8_PWMA_FAULT0 1U
#define SIM_E9_PWMA_FAULT1 1U
#define SIM_F8_TB1 1U
#define SIM_F13_PWMB_FAULT1 1U
#define SIM_F14_PWMB_FAULT0 1U
#define SIM_G0_PWMB_1B 0U
#define SIM_G1_PWMB_1A 0U
#define SIM_G2_PWMB_0B 0U
#define SIM_G3_PWMB_0A 0U
#define SIM_G4_PWMB_3B 0U
#define SIM_G5_PWMB_3A 0U

/* ---- ports: register of a port at GPIO(port) + offset, one bit per pin ------------------------------------------ */

#define GPIO_A 0U
#define GPIO_B 1U
#define GPIO_C 2U
#define GPIO_D 3U
#define GPIO_E 4U
#define GPIO_F 5U
#define GPIO_G 6U
#define GPIO_PORTS 7U
#define GPIO(port) (0xE200U + 0x10U * (port))
#define GPIO_PUR 0x0U
#define GPIO_DR 0x1U
#define GPIO_DDR 0x2U
#define GPIO_PER 0x3U
#define GPIO_PPMODE 0x9U
#define GPIO_RAWDATA 0xAU
#define GPIO_PUS 0xCU

/* ---- interrupt controller --------------------------------------------------------------------------------------- */

#define INTC_BASE 0xE300U
#define INTC_IPRS 13U
#define INTC_CTRL 0xE31BU
#define INTC_CTRL_INT_DIS BIT(5)

/* The priority fields of the peripherals lie in the order of their vectors, eight to a register. */
#define INTC_FIELD(vector) ((vector) - 9U)
#define INTC_IPR_INDEX(vector) (INTC_FIELD(vector) / 8U)
#define INTC_IPR(vector) (INTC_BASE + INTC_IPR_INDEX(vector))
#define INTC_IPR_SHIFT(vector) (2U * (INTC_FIELD(vector) % 8U))
#define INTC_LEVEL_CODE(level) ((level) + 1U) /* 0 is off */
#define INTC_LEVEL(vector, level) FIELD(INTC_IPR_SHIFT(vector), INTC_LEVEL_CODE(level))

#define VECTORS 111U
#define VECTOR_TMRB_0 24U
#define VECTOR_TMRA_0 28U
#define VECTOR_ADC_CC0 30U
#define VECTOR_QSCI0_RCV 52U
#define VECTOR_PWMB_FAULT 63U
#define VECTOR_PWMA_FAULT 77U
#define VECTOR_PWMA_CMP1 85U
#define VECTOR_PWMA_CMP0 87U

#endif
