#include "chip/cop.h"
enum { COP_CTRL, TOUT, COP_CNTR, INTVAL };

#define COP_CWP 0x0001u
#define COP_CEN 0x0002u
#define COP_CLKSEL(x) (((x) >> 5) & 3u)
#define COP_PSS(x) (((x) >> 8) & 3u)
#define COP_FIRST_WORD 0x5555u
#define COP_SECOND_WORD 0xAAAAu

/* Bus clocks per count. */
static uint64_t count_clocks(const cop_t *cop)
{
    static const uint32_t source_hz[4] = {8000000u, 8000000u, CHIP_BUS_HZ, 32768u};
    static const uint32_t prescaler[4] = {1u, 16u, 256u, 1024u};
    const uint16_t ctrl = cop->ctrl;
    return ((uint64_t)CHIP_BUS_HZ * prescaler[COP_PSS(ctrl)] + source_hz[COP_CLKSEL(ctrl)] / 2u) /
           source_hz[COP_CLKSEL(ctrl)];
}

static void restart(cop_t *cop)
{
    cop->start_clock = cop->bus->now;
    cop->half_served = false;
    bus_plan(cop->bus, SOURCE_COP,
             ((cop->ctrl & COP_CEN) != 0) ? cop->bus->now + ((uint64_t)cop->tout + 1u) * count_clocks(cop)
                                          : CHIP_NEVER);
}

void cop_event(void *peripheral, unsigned source)
{
    const cop_t *cop = (const cop_t *)peripheral;
    (void)source;
    cop->bus->signals->reset(cop->bus->chip, RESET_COP);
}

uint16_t cop_read(void *peripheral, uint32_t address)
{
    cop_t *cop = (cop_t *)peripheral;
    switch (address - COP_BASE) {
    case COP_CTRL:
        return cop->ctrl;
    case TOUT:
        return cop->tout;
    case COP_CNTR:
        return ((cop->ctrl & COP_CEN) != 0)
                   ? (uint16_t)(cop->tout - (cop->bus->now - cop->start_clock) / count_clocks(cop))
                   : cop->tout;
    default:
        return cop->intval;
    }
}

void cop_write(void *peripheral, uint32_t address, uint16_t value)
{
    cop_t *cop = (cop_t *)peripheral;
    const uint32_t number = address - COP_BASE;
    const bool locked = (cop->ctrl & COP_CWP) != 0;
    if (number == COP_CNTR) {
        if (value == COP_SECOND_WORD && cop->half_served) {
            cop->services++;
            restart(cop);
        } else {
            cop->half_served = value == COP_FIRST_WORD;
        }
    } else if (locked) {
        return;
    } else if (number == COP_CTRL) {
        bus_allow(cop->bus, address, value, 0x037F, "the interrupt of the watchdog is not modelled");
        const bool same = ((value ^ cop->ctrl) & ~COP_CWP) == 0;
        cop->ctrl = value;
        if (!same) {
            restart(cop);
        }
    } else if (number == TOUT) {
        if ((cop->ctrl & COP_CEN) != 0) {
            bus_no_value(cop->bus, address, value, "TOUT changes while the watchdog counts");
        }
        cop->tout = value;
    } else {
        cop->intval = value;
    }
}

void cop_reset(void *peripheral)
{
    cop_t *cop = (cop_t *)peripheral;
    *cop = (cop_t){
        .bus = cop->bus, .ctrl = COP_CEN | 0x0300u, .tout = 0xFFFF, .intval = 0x00FF, .services = cop->services};
    restart(cop);
}
