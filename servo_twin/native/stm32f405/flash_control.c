#include "stm32f405/flash_control.h"

#include "port/stm32f405/registers.h"

#define NAME "FLASH"
#define FIRST_SECTOR 1u
#define SECTOR_BYTES (4u * FLASH_DATA_SECTOR_WORDS)
#define ACR_MODELLED                                                                                                   \
    (FIELD_MASK(FLASH_ACR_LATENCY) | FLASH_ACR_PRFTEN | FLASH_ACR_ICEN | FLASH_ACR_DCEN | FLASH_ACR_ICRST |            \
     FLASH_ACR_DCRST)
#define CR_MODELLED (FLASH_CR_PG | FLASH_CR_SER | FIELD_MASK(FLASH_CR_SNB) | FIELD_MASK(FLASH_CR_PSIZE) | FLASH_CR_STRT)
#define SR_ERRORS (FLASH_SR_OPERR | FLASH_SR_WRPERR | FLASH_SR_PGAERR | FLASH_SR_PGPERR | FLASH_SR_PGSERR)

static uint64_t now_ns(const flash_control_t *storage) { return board_clocks_ns(storage->soc->bus.now); }

/* The end of a command, not before its last nanosecond. */
static void wait_for_end(flash_control_t *storage, uint64_t duration_ns)
{
    soc_t *soc = storage->soc;
    storage->busy_until = soc->bus.now + board_clocks(duration_ns) + 1u;
    soc->bus.flash_stall = storage->busy_until - soc->bus.now;
    bus_plan(&soc->bus, SOC_EVENT_FLASH, storage->busy_until);
}

void flash_control_event(void *peripheral, unsigned source)
{
    flash_control_t *storage = (flash_control_t *)peripheral;
    flash_t *flash = &storage->flash;
    bus_plan(&storage->soc->bus, source, CHIP_NEVER);
    const bool erased = flash->command == FLASH_ERASE;
    const uint32_t at = flash->at;
    const bool busy = flash_busy(flash, now_ns(storage) + 1u); /* at a power failure for ever */
    storage->busy_until = busy ? storage->busy_until : CHIP_NEVER;
    storage->sr |= (!busy && flash->failed) ? FLASH_SR_OPERR : 0u;
    storage->cr &= ~FLASH_CR_STRT;
    storage->soc->signals->flash_changed(storage->soc->chip, erased ? at * FLASH_DATA_SECTOR_WORDS : at,
                                         erased ? FLASH_DATA_SECTOR_WORDS : 1u);
}

static bool busy(const flash_control_t *storage) { return storage->busy_until != CHIP_NEVER; }

void flash_control_program(flash_control_t *storage, uint32_t at, uint32_t value)
{
    soc_t *soc = storage->soc;
    const uint32_t word = (at - FIRST_SECTOR * SECTOR_BYTES) / 4u;
    if ((storage->cr & FLASH_CR_LOCK) != 0 || (storage->cr & FLASH_CR_PG) == 0 ||
        FIELD_GET(storage->cr, FLASH_CR_PSIZE) != FLASH_CR_PSIZE_32) {
        storage->sr |= FLASH_SR_PGSERR;
        return;
    }
    if (at < FIRST_SECTOR * SECTOR_BYTES || word >= FLASH_WORDS) {
        bus_fail(&soc->bus, "a word of the program at %08lXh is programmed", (unsigned long)(FLASH_MEMORY + at));
    }
    if (!busy(storage)) {
        flash_program(&storage->flash, word, value, now_ns(storage));
        wait_for_end(storage, FLASH_PROGRAM_NS);
    }
}

static void erase(flash_control_t *storage)
{
    const uint32_t sector = FIELD_GET(storage->cr, FLASH_CR_SNB);
    if (sector < FIRST_SECTOR || sector >= FIRST_SECTOR + FLASH_DATA_SECTORS) {
        bus_fail(&storage->soc->bus, "sector %lu of the flash, which is not storage, is erased", (unsigned long)sector);
    }
    flash_erase(&storage->flash, sector - FIRST_SECTOR, now_ns(storage));
    wait_for_end(storage, FLASH_ERASE_NS);
}

uint32_t flash_control_read(void *peripheral, uint32_t offset)
{
    const flash_control_t *storage = (const flash_control_t *)peripheral;
    switch (offset) {
    case FLASH_ACR:
        return storage->acr;
    case FLASH_SR:
        return storage->sr | (busy(storage) ? FLASH_SR_BSY : 0u);
    case FLASH_CR:
        return storage->cr;
    default:
        soc_no_register(storage->soc, NAME, offset);
    }
}

static void write_key(flash_control_t *storage, uint32_t value)
{
    static const uint32_t keys[2] = {FLASH_KEYR_1, FLASH_KEYR_2};
    if (storage->key > 1u || value != keys[storage->key]) {
        soc_no_value(storage->soc, NAME, FLASH_KEYR, value, "a wrong key locks the flash until a reset");
    }
    storage->key++;
    if (storage->key == 2u) {
        storage->cr &= ~FLASH_CR_LOCK;
        storage->key = 0;
    }
}

static void write_cr(flash_control_t *storage, uint32_t value)
{
    soc_allow(storage->soc, NAME, FLASH_CR, value, CR_MODELLED | FLASH_CR_LOCK,
              "a mass erase and interrupts of the flash are not modelled");
    if ((storage->cr & FLASH_CR_LOCK) != 0 && value != FLASH_CR_LOCK) {
        soc_no_value(storage->soc, NAME, FLASH_CR, value, "written while it is locked");
    }
    if (busy(storage)) {
        soc_no_value(storage->soc, NAME, FLASH_CR, value, "written during a command");
    }
    storage->cr = value;
    if ((value & FLASH_CR_STRT) != 0 && (value & FLASH_CR_SER) != 0) {
        erase(storage);
    }
}

void flash_control_write(void *peripheral, uint32_t offset, uint32_t value)
{
    flash_control_t *storage = (flash_control_t *)peripheral;
    switch (offset) {
    case FLASH_ACR:
        soc_allow(storage->soc, NAME, offset, value, ACR_MODELLED, "no such bits");
        storage->acr = value & ~(FLASH_ACR_ICRST | FLASH_ACR_DCRST);
        break;
    case FLASH_KEYR:
        write_key(storage, value);
        break;
    case FLASH_SR:
        storage->sr &= ~(value & (SR_ERRORS | FLASH_SR_EOP));
        break;
    case FLASH_CR:
        write_cr(storage, value);
        break;
    default:
        soc_no_register(storage->soc, NAME, offset);
    }
}

void flash_control_reset(void *peripheral, soc_reset_t cause)
{
    flash_control_t *storage = (flash_control_t *)peripheral;
    (void)cause;
    if (busy(storage)) {
        flash_break_off(&storage->flash, now_ns(storage));
    }
    storage->acr = storage->sr = 0;
    storage->cr = FLASH_CR_LOCK;
    storage->key = 0;
    storage->busy_until = CHIP_NEVER;
    bus_plan(&storage->soc->bus, SOC_EVENT_FLASH, CHIP_NEVER);
}
