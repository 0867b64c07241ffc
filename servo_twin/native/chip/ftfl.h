/* ftfl.h - flash controller: commands on the data flash, which is read at X:8000. */
#ifndef CHIP_FTFL_H
#define CHIP_FTFL_H

#include "chip/bus.h"
#include "flash.h"

#define FTFL_BASE 0xE3C0u
#define FTFL_END 0xE3CCu
#define FTFL_DATA_BASE 0x8000u /* words of 16 bits */
#define FTFL_DATA_END 0xC000u

typedef struct {
    bus_t *bus;
    uint16_t errors;   /* RDCOLERR ACCERR FPVIOL */
    uint16_t fccob[6]; /* as words: FCCOB2 and 3, 0 and 1, 6 and 7, 4 and 5, A and B, 8 and 9 */
    flash_t flash;
} ftfl_t;

uint16_t ftfl_read(void *ftfl, uint32_t address);
void ftfl_write(void *ftfl, uint32_t address, uint16_t value);
uint16_t ftfl_data_read(void *ftfl, uint32_t address);
CHIP_NORETURN void ftfl_data_write(void *ftfl, uint32_t address, uint16_t value); /* an error */
void ftfl_reset(void *ftfl);

#endif
