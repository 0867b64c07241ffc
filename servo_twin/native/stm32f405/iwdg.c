#include "stm32f405/iwdg.h"

#include "port/stm32f405/registers.h"

#define NAME "IWDG"
#define LSI_CLOCKS 5250u /* clocks of 168 MHz per clock of 32 kHz */
#define SLOWEST 6u /* PR above divides by 256, too */

static void reload(iwdg_t *iwdg)
{
    const uint32_t shift = 2u + ((iwdg->pr < SLOWEST) ? iwdg->pr : SLOWEST);
    const uint64_t clocks = ((uint64_t)iwdg->rlr + 1u) << shift;
    bus_plan(&iwdg->soc->bus, SOC_EVENT_WATCHDOG, iwdg->soc->bus.now + clocks * LSI_CLOCKS);
}

void iwdg_event(void *peripheral, unsigned source)
{
    iwdg_t *iwdg = (iwdg_t *)peripheral;
    bus_plan(&iwdg->soc->bus, source, CHIP_NEVER);
    iwdg->soc->signals->reset(iwdg->soc->chip, SOC_RESET_WATCHDOG);
}

uint32_t iwdg_read(void *peripheral, uint32_t offset)
{
    const iwdg_t *iwdg = (const iwdg_t *)peripheral;
    switch (offset) {
    case IWDG_KR:
    case IWDG_SR: /* changes are taken over at once */
        return 0;
    case IWDG_PR:
        return iwdg->pr;
    case IWDG_RLR:
        return iwdg->rlr;
    default:
        soc_no_register(iwdg->soc, NAME, offset);
    }
}

static void write_key(iwdg_t *iwdg, uint32_t value)
{
    iwdg->unlocked = value == IWDG_KR_UNLOCK;
    if (value == IWDG_KR_START) {
        iwdg->started = true;
    } else if (value == IWDG_KR_SERVICE) {
        iwdg->services++;
    } else if (value != IWDG_KR_UNLOCK) {
        soc_no_value(iwdg->soc, NAME, IWDG_KR, value, "this is no key");
    }
    if (iwdg->started && value != IWDG_KR_UNLOCK) {
        reload(iwdg);
    }
}

void iwdg_write(void *peripheral, uint32_t offset, uint32_t value)
{
    iwdg_t *iwdg = (iwdg_t *)peripheral;
    if (offset == IWDG_KR) {
        write_key(iwdg, value);
    } else if (offset == IWDG_PR && iwdg->unlocked) {
        iwdg->pr = value & 7u;
    } else if (offset == IWDG_RLR && iwdg->unlocked) {
        iwdg->rlr = value & 0xFFFu;
    } else if (offset == IWDG_PR || offset == IWDG_RLR) {
        soc_no_value(iwdg->soc, NAME, offset, value, "written while it is locked");
    } else {
        soc_no_register(iwdg->soc, NAME, offset);
    }
}

void iwdg_reset(void *peripheral, soc_reset_t cause)
{
    iwdg_t *iwdg = (iwdg_t *)peripheral;
    (void)cause;
    iwdg->pr = 0;
    iwdg->rlr = 0xFFFu;
    iwdg->unlocked = iwdg->started = false;
    bus_plan(&iwdg->soc->bus, SOC_EVENT_WATCHDOG, CHIP_NEVER);
}
