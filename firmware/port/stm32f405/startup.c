/* startup.c - from reset to the background loop: vector tables, copy of the image to SRAM. Silicon only. */
#include <stdint.h>

#include "config/servo_config.h"
#include "port/arm/image.h"
#include "port/stm32f405/drivers.h"
#include "port/stm32f405/port.h"
#include "port/stm32f405/vectors.h"

#define FIRST 16U /* exception number of interrupt 0 */

extern uint32_t image_stack[];
extern uint32_t image_code[], image_code_end[], image_data[], image_data_end[], image_bss[], image_bss_end[];
extern uint32_t image_dma[], image_dma_end[];
extern const uint32_t image_code_load[], image_data_load[];

void image_reset(void);
int main(void);

static hal_t hal;
static servo_t servo;
__attribute__((section(".dma"))) static dma_memory_t dma;

/* Baud rate of the serial line. Whoever writes the image may set another one here. */
__attribute__((section(".rodata.image_baud"))) const uint32_t image_baud = SERIAL_BAUD;

typedef void (*handler_t)(void);

typedef struct {
    const uint32_t *stack;
    handler_t exception[FIRST - 1U];
    handler_t interrupt[IRQS];
} vectors_t;

/* ---- flash: from reset to the copy of everything else --------------------------------------------------------------- */

#define BOOT __attribute__((section(".start")))

/* The watchdog does not run yet: a debugger finds the core here. */
BOOT static void boot_exception(void)
{
    for (;;) {
    }
}

#define EXCEPTIONS(handler)                                                                                            \
    handler, handler, handler, handler, handler, handler, handler, handler, handler, handler, handler, handler,        \
        handler, handler

__attribute__((section(".boot"), used)) static const struct {
    const uint32_t *stack;
    handler_t exception[FIRST - 1U];
} boot = {image_stack, {image_reset, EXCEPTIONS(boot_exception)}};

/* The boot loader of the chip may have left interrupts on. */
BOOT void image_reset(void)
{
    __asm__ volatile("cpsid i"); /* until INTERRUPTS_ON */
    image_copy(image_code, image_code_end, image_code_load);
    image_copy(image_data, image_data_end, image_data_load);
    image_clear(image_bss, image_bss_end);
    image_clear(image_dma, image_dma_end);
    __asm__ volatile("dsb\n\tisb" : : : "memory"); /* the code was data until here */
    (void)main();
}

/* ---- SRAM ------------------------------------------------------------------------------------------------------------ */

#define HANDLER(number, priority, handler)                                                                             \
    static void isr_##handler(void) { handler(&hal); }
PORT_VECTORS(HANDLER)

/* An exception of the core, the failure of the crystal among them: the outputs are off, and the watchdog resets the board:
 * during the start, before watchdog_start(), with the time of its reset values, half a second.
 * An interrupt that is not in the table ends here as a fault of the core. */
static void unexpected(void)
{
    outputs_off(&hal);
    REG_WRITE(&hal, IWDG_BASE + IWDG_KR, IWDG_KR_START);
    for (;;) {
    }
}

#define ENTRY(number, priority, handler) [number] = isr_##handler,
__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    .stack = image_stack,
    .exception = {image_reset, EXCEPTIONS(unexpected)},
    .interrupt = {PORT_VECTORS(ENTRY)},
};

int main(void)
{
    REG_WRITE(&hal, SCB_VTOR, BUS_ADDRESS(&vectors));
    hal.dma = &dma;
    hal.baud = *(const volatile uint32_t *)&image_baud;
    if (port_init(&hal, &servo, &servo_config)) {
        for (;;) {
            port_background(&hal);
            wait_for_interrupt();
        }
    }
    for (;;) { /* no clock or no carrier: the watchdog resets the board, which tries again */
    }
}
