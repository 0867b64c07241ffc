/* access.h - how a register is reached: the only place that knows whether there is silicon below.
 *
 * All peripherals of the chip are 16-bit words in X data space at word addresses. On the host the same source runs
 * against models of the peripherals (CHIP_ON_HOST): each access is a call with the chip that it is for.
 */
#ifndef PORT_ACCESS_H
#define PORT_ACCESS_H

#include <stdint.h>

#ifdef CHIP_ON_HOST

struct chip;
uint16_t chip_read(struct chip *chip, uint16_t address);
void chip_write(struct chip *chip, uint16_t address, uint16_t value);

#define REG_READ(hal, address) chip_read((hal)->chip, (uint16_t)(address))
#define REG_WRITE(hal, address, value) chip_write((hal)->chip, (uint16_t)(address), (uint16_t)(value))

#else

#define REG_AT(address) (*(volatile uint16_t *)(uint16_t)(address))
#define REG_READ(hal, address) ((void)(hal), REG_AT(address))
#define REG_WRITE(hal, address, value) ((void)(hal), REG_AT(address) = (uint16_t)(value))

#endif

#endif
