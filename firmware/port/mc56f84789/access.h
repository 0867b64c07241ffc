/* access.h - how a register is reached: the only place that depends on whether there is silicon below.
 *
 * All peripherals of the chip are 16-bit words in X data space at word addresses. On the host the same source runs
 * against models of the peripherals (CHIP_ON_HOST): each access is a call with the chip that it is for.
 */
#ifndef PORT_ACCESS_H
#define PORT_ACCESS_H

#include <stdbool.h>
#include <stdint.h>

#ifdef CHIP_ON_HOST

struct chip;
uint16_t chip_read(struct chip *chip, uint32_t address);
void chip_write(struct chip *chip, uint32_t address, uint16_t value);
void chip_interrupts(struct chip *chip, bool on);

#define REG_READ(hal, address) chip_read((hal)->chip, (address))
#define REG_WRITE(hal, address, value) chip_write((hal)->chip, (address), (uint16_t)(value))
#define INTERRUPTS_ON(hal) chip_interrupts((hal)->chip, true)

#else

#ifdef __arm__ /* a chip that does not exist: word a of the DSC's data space at PERIPHERALS + 2a */
#define PERIPHERALS 0x40000000UL
#define REG_AT(address) (*(volatile uint16_t *)(PERIPHERALS + 2UL * (uint16_t)(address)))
#else
#define REG_AT(address) (*(volatile uint16_t *)(uintptr_t)(uint16_t)(address))
#endif
#define REG_READ(hal, address) ((void)(hal), REG_AT(address))
#define REG_WRITE(hal, address, value) ((void)(hal), REG_AT(address) = (uint16_t)(value))

#ifdef __MWERKS__
#define INTERRUPTS_ON(hal) ((void)(hal), __EI(0)) /* levels 0 to 3 */
#elif defined(__arm__)
#define INTERRUPTS_ON(hal) ((void)(hal), interrupts_on())
static inline void interrupts_on(void) { __asm__ volatile("cpsie i" : : : "memory"); }
#else
#define INTERRUPTS_ON(hal) ((void)(hal)) /* another compiler only checks the source */
#endif

/* Between two runs of the background: only an interrupt gives it something to do. */
#ifdef __arm__
#define WAIT_FOR_INTERRUPT() __asm__ volatile("wfi" : : : "memory")
#else
#define WAIT_FOR_INTERRUPT() ((void)0)
#endif

#endif

#endif
