#include "stm32f405/soc.h"

void soc_no_register(soc_t *soc, const char *name, uint32_t offset)
{
    bus_fail(&soc->bus, "%s register %02lXh is not modelled", name, (unsigned long)offset);
}

void soc_no_value(soc_t *soc, const char *name, uint32_t offset, uint32_t value, const char *why)
{
    bus_fail(&soc->bus, "%s register %02lXh = %08lXh: %s", name, (unsigned long)offset, (unsigned long)value, why);
}

void soc_check_gate(soc_t *soc, const char *name, soc_gate_t gate, unsigned bit)
{
    static const char *const registers[SOC_GATES] = {"AHB1ENR", "APB1ENR", "APB2ENR"};
    if ((soc->enabled[gate] >> bit & 1u) == 0) {
        bus_fail(&soc->bus, "%s is accessed while its clock is off (RCC_%s bit %u)", name, registers[gate], bit);
    }
}

void soc_need_clock(soc_t *soc, const char *name)
{
    if (!soc->clocked) {
        bus_fail(&soc->bus, "%s starts at another clock than 168 MHz of the core, 42 and 84 MHz of the buses", name);
    }
}
