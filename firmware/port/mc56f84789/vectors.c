/* vectors.c - vector table in program flash, and interrupt entry. Silicon only. */
#include "port/mc56f84789/vectors.h"

#include "port/mc56f84789/access.h"
#include "port/mc56f84789/startup.h"

#ifndef CHIP_ON_HOST

#ifdef __MWERKS__
#define INTERRUPTS_BEGIN _Pragma("interrupt alignsp saveall")
#define INTERRUPTS_END _Pragma("interrupt off")
#else
#define INTERRUPTS_BEGIN
#define INTERRUPTS_END
#endif

INTERRUPTS_BEGIN

void isr_break_1(void) { port_break_1(&startup_hal); }
void isr_break_2(void) { port_break_2(&startup_hal); }
void isr_m1(void) { port_m1(&startup_hal); }
void isr_m2(void) { port_m2(&startup_hal); }
void isr_start(void) { port_start(&startup_hal); }
void isr_edge_1(void) { port_edge_1(&startup_hal); }
void isr_edge_2(void) { port_edge_2(&startup_hal); }
void isr_receive(void) { port_receive(&startup_hal); }

/* An interrupt that was not enabled: switch the outputs off and let the watchdog reset the board. */
void isr_unexpected(void)
{
    REG_WRITE(&startup_hal, PWMA_BASE + PWM_OUTEN, 0U);
    REG_WRITE(&startup_hal, PWMB_BASE + PWM_OUTEN, 0U);
    for (;;) {
    }
}

INTERRUPTS_END

#ifdef __MWERKS__
/* clang-format off */
/* Two words each, at P:0. */
volatile asm void vector_table(void);
#pragma define_section interrupt_vectors "interrupt_vectors.text" RX
#pragma section interrupt_vectors begin
volatile asm void vector_table(void)
{
    JMP >startup_entry     /*   0 reset */
    JMP >startup_entry     /*   1 reset after COP */
    JSR >isr_unexpected    /*   2 ILLEGAL_OP */
    JSR >isr_unexpected    /*   3 SWI3 */
    JSR >isr_unexpected    /*   4 OVERFLOW */
    JSR >isr_unexpected    /*   5 MISALIGNED */
    JSR >isr_unexpected    /*   6 STPCNT */
    JSR >isr_unexpected    /*   7 BKPT */
    JSR >isr_unexpected    /*   8 TRBUF */
    JSR >isr_unexpected    /*   9 TX_REG */
    JSR >isr_unexpected    /*  10 RX_REG */
    JSR >isr_unexpected    /*  11 BUS_ERR */
    JSR >isr_unexpected    /*  12 reserved */
    JSR >isr_unexpected    /*  13 reserved */
    JSR >isr_unexpected    /*  14 reserved */
    JSR >isr_unexpected    /*  15 SWI2 */
    JSR >isr_unexpected    /*  16 SWI1 */
    JSR >isr_unexpected    /*  17 SWI0 */
    JSR >isr_unexpected    /*  18 XBARA */
    JSR >isr_unexpected    /*  19 LVI1 */
    JSR >isr_unexpected    /*  20 OCCS */
    JSR >isr_unexpected    /*  21 TMRB_3 */
    JSR >isr_unexpected    /*  22 TMRB_2 */
    JSR >isr_unexpected    /*  23 TMRB_1 */
    JSR >isr_edge_2        /*  24 TMRB_0 */
    JSR >isr_unexpected    /*  25 TMRA_3 */
    JSR >isr_unexpected    /*  26 TMRA_2 */
    JSR >isr_unexpected    /*  27 TMRA_1 */
    JSR >isr_edge_1        /*  28 TMRA_0 */
    JSR >isr_unexpected    /*  29 ADC_CC1 */
    JSR >isr_m2            /*  30 ADC_CC0 */
    JSR >isr_unexpected    /*  31 ADC_ERR */
    JSR >isr_unexpected    /*  32 COCO */
    JSR >isr_unexpected    /*  33 DMA3 */
    JSR >isr_unexpected    /*  34 DMA2 */
    JSR >isr_unexpected    /*  35 DMA1 */
    JSR >isr_unexpected    /*  36 DMA0 */
    JSR >isr_unexpected    /*  37 CAN_MB_OR */
    JSR >isr_unexpected    /*  38 CAN_BUS_OFF */
    JSR >isr_unexpected    /*  39 CAN_ERROR */
    JSR >isr_unexpected    /*  40 CAN_TX_WARN */
    JSR >isr_unexpected    /*  41 CAN_RX_WARN */
    JSR >isr_unexpected    /*  42 CAN_WAKEUP */
    JSR >isr_unexpected    /*  43 QSCI2_RERR */
    JSR >isr_unexpected    /*  44 QSCI2_RCV */
    JSR >isr_unexpected    /*  45 QSCI2_TIDLE */
    JSR >isr_unexpected    /*  46 QSCI2_TDRE */
    JSR >isr_unexpected    /*  47 QSCI1_RERR */
    JSR >isr_unexpected    /*  48 QSCI1_RCV */
    JSR >isr_unexpected    /*  49 QSCI1_TIDLE */
    JSR >isr_unexpected    /*  50 QSCI1_TDRE */
    JSR >isr_unexpected    /*  51 QSCI0_RERR */
    JSR >isr_receive       /*  52 QSCI0_RCV */
    JSR >isr_unexpected    /*  53 QSCI0_TIDLE */
    JSR >isr_unexpected    /*  54 QSCI0_TDRE */
    JSR >isr_unexpected    /*  55 QSPI2_XMIT */
    JSR >isr_unexpected    /*  56 QSPI2_RCV */
    JSR >isr_unexpected    /*  57 QSPI1_XMIT */
    JSR >isr_unexpected    /*  58 QSPI1_RCV */
    JSR >isr_unexpected    /*  59 QSPI0_XMIT */
    JSR >isr_unexpected    /*  60 QSPI0_RCV */
    JSR >isr_unexpected    /*  61 I2C1 */
    JSR >isr_unexpected    /*  62 I2C0 */
    JSR >isr_break_2       /*  63 PWMB_FAULT */
    JSR >isr_unexpected    /*  64 PWMB_RERR */
    JSR >isr_unexpected    /*  65 PWMB_RELOAD3 */
    JSR >isr_unexpected    /*  66 PWMB_CAP3 */
    JSR >isr_unexpected    /*  67 PWMB_CMP3 */
    JSR >isr_unexpected    /*  68 PWMB_RELOAD2 */
    JSR >isr_unexpected    /*  69 PWMB_CAP2 */
    JSR >isr_unexpected    /*  70 PWMB_CMP2 */
    JSR >isr_unexpected    /*  71 PWMB_RELOAD1 */
    JSR >isr_unexpected    /*  72 PWMB_CAP1 */
    JSR >isr_unexpected    /*  73 PWMB_CMP1 */
    JSR >isr_unexpected    /*  74 PWMB_RELOAD0 */
    JSR >isr_unexpected    /*  75 PWMB_CAP0 */
    JSR >isr_unexpected    /*  76 PWMB_CMP0 */
    JSR >isr_break_1       /*  77 PWMA_FAULT */
    JSR >isr_unexpected    /*  78 PWMA_RERR */
    JSR >isr_unexpected    /*  79 PWMA_RELOAD3 */
    JSR >isr_unexpected    /*  80 PWMA_CAP */
    JSR >isr_unexpected    /*  81 PWMA_CMP3 */
    JSR >isr_unexpected    /*  82 PWMA_RELOAD2 */
    JSR >isr_unexpected    /*  83 PWMA_CMP2 */
    JSR >isr_unexpected    /*  84 PWMA_RELOAD1 */
    JSR >isr_m1            /*  85 PWMA_CMP1 */
    JSR >isr_unexpected    /*  86 PWMA_RELOAD0 */
    JSR >isr_start         /*  87 PWMA_CMP0 */
    JSR >isr_unexpected    /*  88 FTFL_RDCOL */
    JSR >isr_unexpected    /*  89 FTFL_CC */
    JSR >isr_unexpected    /*  90 CMPD */
    JSR >isr_unexpected    /*  91 CMPC */
    JSR >isr_unexpected    /*  92 CMPB */
    JSR >isr_unexpected    /*  93 CMPA */
    JSR >isr_unexpected    /*  94 PIT1_ROLLOVR */
    JSR >isr_unexpected    /*  95 PIT0_ROLLOVR */
    JSR >isr_unexpected    /*  96 PDB1 */
    JSR >isr_unexpected    /*  97 PDB0 */
    JSR >isr_unexpected    /*  98 QDC_INDEX_RO_RU */
    JSR >isr_unexpected    /*  99 QDC_HOME_DOG */
    JSR >isr_unexpected    /* 100 QDC_COMPARE */
    JSR >isr_unexpected    /* 101 GPIOG */
    JSR >isr_unexpected    /* 102 GPIOF */
    JSR >isr_unexpected    /* 103 GPIOE */
    JSR >isr_unexpected    /* 104 GPIOD */
    JSR >isr_unexpected    /* 105 GPIOC */
    JSR >isr_unexpected    /* 106 GPIOB */
    JSR >isr_unexpected    /* 107 GPIOA */
    JSR >isr_unexpected    /* 108 COP_INT */
    JSR >isr_unexpected    /* 109 EWM_INT */
    JSR >isr_unexpected    /* 110 SWILP */
}
#pragma section interrupt_vectors end
/* clang-format on */
#endif

#else

typedef int vectors_are_for_silicon; /* a translation unit is not empty */

#endif
