#include "machine.h"

#include <stdbool.h>

#define REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))

/* CMSDK UART0 */
#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u)
#define UART_CTRL REGISTER(0x40004008u)
#define UART_BAUDDIV REGISTER(0x40004010u)
#define UART_STATE_TX_FULL 1u
#define UART_CTRL_TX_ENABLE 1u

/* System timer: 24 bits, downwards, 25 MHz. */
#define SYST_CSR REGISTER(0xE000E010u)
#define SYST_RVR REGISTER(0xE000E014u)
#define SYST_CVR REGISTER(0xE000E018u)
#define SYST_MASK 0x00FFFFFFu

/* With -icount shift=10 one instruction takes 1024 ns: 25.6 ticks. */
#define TICKS_OF_5 128u
/* Between the readings of two consecutive clock values only the reading itself runs. */
#define READING 3u

#define EXTERNAL_MEMORY 0x21000000u

#define SEMIHOSTING_EXIT_EXTENDED 0x20u
#define STOPPED_BY_APPLICATION 0x20026u

void machine_start(void)
{
    UART_BAUDDIV = 16;
    UART_CTRL = UART_CTRL_TX_ENABLE;
    SYST_RVR = SYST_MASK;
    SYST_CVR = 0;
    SYST_CSR = 5; /* processor clock, no interrupt */
}

uint8_t machine_image(uint32_t at) { return *(const volatile uint8_t *)(uintptr_t)(EXTERNAL_MEMORY + at); }

void machine_print(const char *text)
{
    while (*text != '\0') {
        while ((UART_STATE & UART_STATE_TX_FULL) != 0u) {
        }
        UART_DATA = (uint32_t)(uint8_t)*text++;
    }
}

void machine_print_hex(uint32_t value)
{
    char text[10];
    for (uint32_t k = 0; k < 8u; k++) {
        text[k] = "0123456789abcdef"[value >> (28u - 4u * k) & 15u];
    }
    text[8] = '\n';
    text[9] = '\0';
    machine_print(text);
}

void machine_stop(int status)
{
    const uint32_t block[2] = {STOPPED_BY_APPLICATION, (uint32_t)status};
    register uint32_t operation __asm__("r0") = SEMIHOSTING_EXIT_EXTENDED;
    register const uint32_t *argument __asm__("r1") = block;
    __asm__ volatile("bkpt 0xAB" : : "r"(operation), "r"(argument), "m"(block) : "memory");
    for (;;) {
    }
}

uint32_t machine_clock(void) { return SYST_CVR; }

uint32_t machine_instructions(uint32_t begin, uint32_t end)
{
    const uint32_t ticks = (begin - end) & SYST_MASK;
    return (ticks * 5u + TICKS_OF_5 / 2u) / TICKS_OF_5 - READING;
}
