/* flash.c - the last sectors of the data flash; the first ones hold the tables of the linker file. A flash command runs
 * while the program continues from the program flash, which is another block. The data flash cannot be read
 * meanwhile. */
#include "port/mc56f84789/drivers.h"

#define FIRST_SECTOR (DATA_FLASH_SECTORS - HAL_FLASH_SECTORS)
#define WORDS_16 2U /* within a word of 32 bits */

bool hal_flash_present(hal_t *hal) { return wait_for(hal, FTFL_STAT, FTFL_STAT_CCIF, FTFL_STAT_CCIF); }

/* Offset in 16-bit words from the beginning of the data flash. */
static uint16_t offset_of(uint16_t word)
{
    return (uint16_t)((FIRST_SECTOR * HAL_FLASH_SECTOR_WORDS + word) * WORDS_16);
}

uint32_t hal_flash_read(hal_t *hal, uint16_t word)
{
    const uint16_t address = (uint16_t)(DATA_FLASH_BASE + offset_of(word));
    const uint32_t low = REG_READ(hal, address);
    return (uint32_t)REG_READ(hal, address + 1U) << 16 | low;
}

/* Error flags of the previous command would block this one. The controller addresses bytes. */
static void launch(hal_t *hal, uint16_t command, uint16_t word)
{
    REG_WRITE(hal, FTFL_STAT, FTFL_STAT_ERRORS);
    REG_WRITE(hal, FTFL_FCCOB_COMMAND, FTFL_COMMAND(command) | FTFL_ADDRESS_DATA);
    REG_WRITE(hal, FTFL_FCCOB_ADDRESS, 2U * offset_of(word));
    REG_WRITE(hal, FTFL_STAT, FTFL_STAT_CCIF);
}

void hal_flash_erase(hal_t *hal, uint16_t sector)
{
    launch(hal, FTFL_ERASE_SECTOR, (uint16_t)(sector * HAL_FLASH_SECTOR_WORDS));
}

void hal_flash_program(hal_t *hal, uint16_t word, uint32_t value)
{
    REG_WRITE(hal, FTFL_FCCOB_LOW, (uint16_t)value);
    REG_WRITE(hal, FTFL_FCCOB_HIGH, value >> 16);
    launch(hal, FTFL_PROGRAM_LONGWORD, word);
}

hal_flash_t hal_flash_result(hal_t *hal)
{
    const uint16_t status = REG_READ(hal, FTFL_STAT);
    if ((status & FTFL_STAT_CCIF) == 0U) {
        return HAL_FLASH_BUSY;
    }
    return ((status & (FTFL_STAT_ERRORS | FTFL_STAT_MGSTAT0)) == 0U) ? HAL_FLASH_DONE : HAL_FLASH_FAILED;
}
