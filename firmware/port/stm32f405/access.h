/* access.h - how a register is reached: the only place that depends on whether there is silicon below. */
#ifndef STM32F405_ACCESS_H
#define STM32F405_ACCESS_H

#include <stdbool.h>
#include <stdint.h>

#ifdef CHIP_ON_HOST

struct chip;
uint32_t chip_read(struct chip *chip, uint32_t address);
void chip_write(struct chip *chip, uint32_t address, uint32_t value);
void chip_interrupts(struct chip *chip, bool on);
uint32_t chip_interrupts_off(struct chip *chip);
void chip_interrupts_restore(struct chip *chip, uint32_t before);

#define REG_READ(hal, address) chip_read((hal)->chip, (address))
#define REG_WRITE(hal, address, value) chip_write((hal)->chip, (address), (value))
#define INTERRUPTS_ON(hal) chip_interrupts((hal)->chip, true)
#define INTERRUPTS_OFF(hal) chip_interrupts_off((hal)->chip)
#define INTERRUPTS_RESTORE(hal, before) chip_interrupts_restore((hal)->chip, (before))
#define BUS_ADDRESS(pointer) ((uint32_t)(uintptr_t)(pointer)) /* no DMA on the host */

#else

#define REG_READ(hal, address) ((void)(hal), *(volatile uint32_t *)(address))
#define REG_WRITE(hal, address, value) ((void)(hal), *(volatile uint32_t *)(address) = (value))
#define INTERRUPTS_ON(hal) ((void)(hal), interrupts_on())
/* For a few instructions that no interrupt may divide, not even that of a fault: the value before, and back to it. */
#define INTERRUPTS_OFF(hal) ((void)(hal), interrupts_off())
#define INTERRUPTS_RESTORE(hal, before) ((void)(hal), interrupts_restore(before))
#define BUS_ADDRESS(pointer) ((uint32_t)(pointer))

static inline void interrupts_on(void) { __asm__ volatile("cpsie i" : : : "memory"); }

static inline uint32_t interrupts_off(void)
{
    uint32_t before;
    __asm__ volatile("mrs %0, primask\n\tcpsid i" : "=r"(before) : : "memory");
    return before;
}

static inline void interrupts_restore(uint32_t before)
{
    __asm__ volatile("msr primask, %0" : : "r"(before) : "memory");
}

static inline void wait_for_interrupt(void) { __asm__ volatile("wfi" : : : "memory"); }

#endif

#endif
