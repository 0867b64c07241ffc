/* flash_control.h - the flash interface: wait states, erase and program of the sectors that the firmware uses as storage (flash.h).
 *
 * The memory has one bank: while a command runs, a read of the flash waits for its end, and so does the core, which executes from
 * there. A command on another sector would change the program and is an error.
 */
#ifndef STM32F405_FLASH_CONTROL_H
#define STM32F405_FLASH_CONTROL_H

#include "flash.h"
#include "stm32f405/soc.h"

typedef struct {
    soc_t *soc;
    flash_t flash;
    uint32_t acr, cr, sr; /* without BSY */
    unsigned key; /* keys written in order */
    uint64_t busy_until; /* end of the command; CHIP_NEVER without one */
} flash_control_t;

uint32_t flash_control_read(void *storage, uint32_t offset);
void flash_control_write(void *storage, uint32_t offset, uint32_t value);
void flash_control_reset(void *storage, soc_reset_t cause);
void flash_control_event(void *storage, unsigned source);

/* A word of the memory is written, at an offset from the beginning of the flash. */
void flash_control_program(flash_control_t *storage, uint32_t at, uint32_t value);

#endif
