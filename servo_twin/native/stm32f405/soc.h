/* soc.h - what the peripherals of the STM32F405 share: the bus_t with clock, event queue, interrupt requests and errors
 * (chip/bus.h), the clock gates of the RCC, and the signals between them as a table of functions, which chip.c fills in.
 *
 * A peripheral includes this header and its own one, none of another peripheral: so each of them runs alone in a test. Time is
 * counted in clocks of 168 MHz since power-on, by which the core and the timers of APB2 count.
 */
#ifndef STM32F405_SOC_H
#define STM32F405_SOC_H

#include "chip/bus.h"

/* Clocks of the 168 MHz per clock of a bus. */
#define SOC_APB1_CLOCKS 4u /* 42 MHz */
#define SOC_APB2_CLOCKS 2u /* 84 MHz */
#define SOC_HZ 168000000.0

/* Timers, in this order everywhere. */
typedef enum { SOC_TIM1, SOC_TIM8, SOC_TIM2, SOC_TIM3, SOC_TIM4, SOC_TIM5, SOC_TIM12, SOC_TIMERS } soc_timer_t;

#define SOC_ADCS 3u
#define SOC_PORTS 4u /* A to D */
#define SOC_PIN(port, number) (((unsigned)(port) - 'A') << 4 | (number))

/* Sources of events; at one clock they are handled in this order. */
typedef enum {
    SOC_EVENT_TIMER, /* one per timer */
    SOC_EVENT_ADC = SOC_EVENT_TIMER + SOC_TIMERS, /* one per converter */
    SOC_EVENT_USART = SOC_EVENT_ADC + SOC_ADCS,
    SOC_EVENT_SPI,
    SOC_EVENT_FLASH,
    SOC_EVENT_WATCHDOG,
    SOC_EVENT_DRIVER, /* gate drivers: end of their start */
    SOC_EVENTS
} soc_event_t;

typedef char soc_events_fit_t[(SOC_EVENTS <= EVENT_SOURCES) ? 1 : -1];

/* Interrupts (RM0090, vector table). */
typedef enum {
    SOC_IRQ_FLASH = 4,
    SOC_IRQ_EXTI0 = 6,
    SOC_IRQ_DMA1_S0 = 11,
    SOC_IRQ_ADC = 18,
    SOC_IRQ_EXTI9_5 = 23,
    SOC_IRQ_TIM1_BRK = 24,
    SOC_IRQ_TIM1_UP = 25,
    SOC_IRQ_TIM1_TRG = 26,
    SOC_IRQ_TIM1_CC = 27,
    SOC_IRQ_TIM2 = 28,
    SOC_IRQ_TIM3 = 29,
    SOC_IRQ_TIM4 = 30,
    SOC_IRQ_USART2 = 38,
    SOC_IRQ_EXTI15_10 = 40,
    SOC_IRQ_TIM8_BRK = 43, /* and TIM12 */
    SOC_IRQ_TIM8_UP = 44,
    SOC_IRQ_TIM8_TRG = 45,
    SOC_IRQ_TIM8_CC = 46,
    SOC_IRQ_DMA1_S7 = 47,
    SOC_IRQ_TIM5 = 50,
    SOC_IRQ_SPI3 = 51,
    SOC_IRQ_DMA2_S0 = 56,
    SOC_IRQ_DMA2_S5 = 68,
    SOC_IRQS = 82
} soc_irq_t;

/* Clock gates: enable registers of the RCC. */
typedef enum { SOC_AHB1, SOC_APB1, SOC_APB2, SOC_GATES } soc_gate_t;

/* Requests of peripherals to the DMA controllers. */
typedef enum {
    SOC_DMA_ADC1,
    SOC_DMA_ADC2,
    SOC_DMA_ADC3,
    SOC_DMA_USART2_RX,
    SOC_DMA_USART2_TX,
    SOC_DMA_SPI3_RX,
    SOC_DMA_SPI3_TX,
    SOC_DMA_REQUESTS
} soc_dma_t;

/* Sources of triggers for converters and timers. */
typedef enum { SOC_TRIGGER_TRGO, SOC_TRIGGER_CC1, SOC_TRIGGER_CC2, SOC_TRIGGER_CC3, SOC_TRIGGER_CC4 } soc_trigger_t;

typedef enum { SOC_RESET_POWER_ON, SOC_RESET_WATCHDOG, SOC_RESET_SOFTWARE } soc_reset_t;

/* Signals from one peripheral to another, at the present clock. */
typedef struct {
    void (*timer_pins)(void *chip, soc_timer_t timer); /* outputs of a timer have changed */
    void (*trigger)(void *chip, soc_timer_t timer, soc_trigger_t trigger, bool rising);
    void (*pin_changed)(void *chip, unsigned pin, bool level);
    void (*pins_configured)(void *chip); /* modes or functions of pins */
    void (*edge_line)(void *chip, unsigned line); /* an EXTI line that converters may use */
    void (*dma_request)(void *chip, soc_dma_t request, bool on);
    bool (*dma_read)(void *chip, uint32_t address, unsigned size, uint32_t *value); /* by a DMA controller */
    bool (*dma_write)(void *chip, uint32_t address, unsigned size, uint32_t value);
    uint16_t (*spi_exchange)(void *chip, uint16_t word); /* with the selected devices, mode 1 */
    void (*driver_changed)(void *chip, unsigned driver); /* gates or fault of a gate driver */
    void (*flash_changed)(void *chip, uint32_t first, uint32_t words); /* words of the storage */
    void (*reset)(void *chip, soc_reset_t cause); /* does not return */
} soc_signals_t;

typedef struct {
    bus_t bus;
    const soc_signals_t *signals;
    void *chip; /* first argument of the signals */
    uint32_t enabled[SOC_GATES]; /* clock gates */
    bool clocked; /* the core and the buses run at 168, 42 and 84 MHz */
    uint32_t holders[SOC_IRQS]; /* requests of an interrupt, a bit per peripheral that shares it */
} soc_t;

/* ---- errors --------------------------------------------------------------------------------------------------------- */

/* End the run: "TIM1 18h = 00000000h: why". */
CHIP_NORETURN void soc_no_register(soc_t *soc, const char *name, uint32_t offset);
CHIP_NORETURN void soc_no_value(soc_t *soc, const char *name, uint32_t offset, uint32_t value, const char *why);

/* Refuse all bits of a value that are not allowed. */
static inline void soc_allow(soc_t *soc, const char *name, uint32_t offset, uint32_t value, uint32_t allowed,
                             const char *why)
{
    if ((value & ~allowed) != 0) {
        soc_no_value(soc, name, offset, value, why);
    }
}

/* Refuse an access to a peripheral without a clock, or at another clock than the modelled one. */
void soc_check_gate(soc_t *soc, const char *name, soc_gate_t gate, unsigned bit);
void soc_need_clock(soc_t *soc, const char *name);

/* ---- interrupts ----------------------------------------------------------------------------------------------------- */

/* Set or clear the request of a peripheral; `holder` tells those apart that share an interrupt. */
static inline void soc_request(soc_t *soc, unsigned irq, unsigned holder, bool on)
{
    const uint32_t bit = UINT32_C(1) << holder;
    soc->holders[irq] = on ? soc->holders[irq] | bit : soc->holders[irq] & ~bit;
    bus_request(&soc->bus, irq, soc->holders[irq] != 0);
}

#endif
