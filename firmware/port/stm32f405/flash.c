/* flash.c - sectors of the program flash for the stored set. Any read of the flash during a command stalls the core:
 * nothing is fetched from it, and its words are read between commands only. */
#include "port/stm32f405/drivers.h"

#define ERRORS (FLASH_SR_OPERR | FLASH_SR_WRPERR | FLASH_SR_PGAERR | FLASH_SR_PGPERR | FLASH_SR_PGSERR)

static uint32_t address_of(uint16_t word) { return FLASH_SECTOR_ADDRESS(STORED_FIRST_SECTOR) + 4U * (uint32_t)word; }

bool hal_flash_present(hal_t *hal) { return wait_for(hal, FLASH_BASE + FLASH_SR, FLASH_SR_BSY, 0U); }

uint32_t hal_flash_read(hal_t *hal, uint16_t word) { return REG_READ(hal, address_of(word)); }

static bool is_locked(hal_t *hal) { return (REG_READ(hal, FLASH_BASE + FLASH_CR) & FLASH_CR_LOCK) != 0U; }

/* Error flags of the previous command would block this one. */
static void prepare(hal_t *hal)
{
    if (is_locked(hal)) {
        REG_WRITE(hal, FLASH_BASE + FLASH_KEYR, FLASH_KEYR_1);
        REG_WRITE(hal, FLASH_BASE + FLASH_KEYR, FLASH_KEYR_2);
    }
    REG_WRITE(hal, FLASH_BASE + FLASH_SR, ERRORS | FLASH_SR_EOP);
}

void hal_flash_erase(hal_t *hal, uint16_t sector)
{
    const uint32_t command = SET_FLASH_CR | FLASH_CR_SER | FLASH_CR_SNB(STORED_FIRST_SECTOR + (uint32_t)sector);
    prepare(hal);
    REG_WRITE(hal, FLASH_BASE + FLASH_CR, command);
    REG_WRITE(hal, FLASH_BASE + FLASH_CR, command | FLASH_CR_STRT);
}

void hal_flash_program(hal_t *hal, uint16_t word, uint32_t value)
{
    prepare(hal);
    REG_WRITE(hal, FLASH_BASE + FLASH_CR, SET_FLASH_CR | FLASH_CR_PG);
    REG_WRITE(hal, address_of(word), value);
}

/* A command that has ended is locked; a write of the control register during one would stall the core. */
hal_flash_t hal_flash_result(hal_t *hal)
{
    const uint32_t status = REG_READ(hal, FLASH_BASE + FLASH_SR);
    if ((status & FLASH_SR_BSY) != 0U) {
        return HAL_FLASH_BUSY;
    }
    if (!is_locked(hal)) {
        REG_WRITE(hal, FLASH_BASE + FLASH_CR, FLASH_CR_LOCK);
    }
    return ((status & ERRORS) == 0U) ? HAL_FLASH_DONE : HAL_FLASH_FAILED;
}
