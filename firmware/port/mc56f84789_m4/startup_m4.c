/* startup_m4.c - vector table and reset of the chip that does not exist: the peripherals of the MC56F84789 with the core of a
 * Cortex-M4 (README.md). The main program and the handlers are those of the DSC. */
#include <stdint.h>

#include "port/arm/image.h"
#include "port/mc56f84789/access.h"
#include "port/mc56f84789/startup.h"
#include "port/mc56f84789/vectors.h"

#define FIRST 16U /* exception number of interrupt 0 */
#define INTERRUPTS 111U
#define LEVELS 3U
#define PRIORITY(level) ((uint8_t)((LEVELS - (level)) << 4)) /* a lower number comes first; four bits, the upper ones */

#define NVIC_ISER(n) (*(volatile uint32_t *)(0xE000E100UL + 4UL * ((n) / 32UL)))
#define NVIC_IPR(n) (*(volatile uint32_t *)(0xE000E400UL + ((n) & ~3UL)))

extern uint32_t image_stack[];
extern uint32_t image_data[], image_data_end[], image_bss[], image_bss_end[];
extern const uint32_t image_data_load[];

void image_reset(void);

typedef void (*handler_t)(void);

typedef struct {
    const uint32_t *stack;
    handler_t exception[FIRST - 1U];
    handler_t interrupt[INTERRUPTS];
} vectors_t;

/* Exceptions of the core come before the initialisation of the data as well; the watchdog resets the board. */
static void core_exception(void)
{
    for (;;) {
    }
}

/* An interrupt has the number of its vector in the table of the DSC (vectors.c). */
__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    .stack = image_stack,
    .exception = {image_reset, core_exception, core_exception, core_exception, core_exception, core_exception,
                  core_exception, core_exception, core_exception, core_exception, core_exception, core_exception,
                  core_exception, core_exception, core_exception},
    .interrupt =
        {
            [VECTOR_PWMA_FAULT] = isr_break_1,
            [VECTOR_PWMB_FAULT] = isr_break_2,
            [VECTOR_PWMA_CMP1] = isr_m1,
            [VECTOR_ADC_CC0] = isr_m2,
            [VECTOR_PWMA_CMP0] = isr_start,
            [VECTOR_TMRA_0] = isr_edge_1,
            [VECTOR_TMRB_0] = isr_edge_2,
            [VECTOR_QSCI0_RCV] = isr_receive,
        },
};

/* Baud rate of the serial line. Whoever writes the image may set another one here. */
__attribute__((section(".rodata.image_baud"))) const uint32_t image_baud = SERIAL_BAUD;

static void enable_interrupt(uint32_t interrupt, uint32_t priority)
{
    NVIC_IPR(interrupt) |= priority << (8U * (interrupt & 3U));
    NVIC_ISER(interrupt) = 1UL << (interrupt % 32U);
}

#define ENABLE(vector, level, handler) enable_interrupt(vector, PRIORITY(level));

void image_reset(void)
{
    __asm__ volatile("cpsid i"); /* until INTERRUPTS_ON */
    image_copy(image_data, image_data_end, image_data_load);
    image_clear(image_bss, image_bss_end);
    PORT_VECTORS(ENABLE)
    startup_hal.baud = *(const volatile uint32_t *)&image_baud;
    (void)main();
}
