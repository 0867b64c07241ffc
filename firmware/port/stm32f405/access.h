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

#define REG_READ(hal, address) chip_read((hal)->chip, (address))
#define REG_WRITE(hal, address, value) chip_write((hal)->chip, (address), (value))
#define INTERRUPTS_ON(hal) chip_interrupts((hal)->chip, true)
#define BUS_ADDRESS(pointer) ((uint32_t)(uintptr_t)(pointer)) /* no DMA on the host */

#else

#define REG_READ(hal, address) ((void)(hal), *(volatile uint32_t *)(address))
#define REG_WRITE(hal, address, value) ((void)(hal), *(volatile uint32_t *)(address) = (value))
#define INTERRUPTS_ON(hal) ((void)(hal), interrupts_on())
#define BUS_ADDRESS(pointer) ((uint32_t)(pointer))

static inline void interrupts_on(void) { __asm__ volatile("cpsie i" : : : "memory"); }
static inline void wait_for_interrupt(void) { __asm__ volatile("wfi" : : : "memory"); }

#endif

#endif
