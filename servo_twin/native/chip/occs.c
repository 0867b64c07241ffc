#include "chip/occs.h"
enum { OCCS_CTRL, DIVBY, OCCS_STAT, OSCTL1 = 4, OSCTL2, CLKCHKR, CLKCHKT, OCCS_PROT };

#define CTRL_ZSRC 0x0001u
#define CTRL_PRECS(x) (((x) >> 2) & 3u)
#define CTRL_PLLPD 0x0010u
#define CTRL_LCKON 0x0080u
#define OSCTL1_ROPD 0x8000u
#define OSCTL2_COPD 0x4000u
#define PRECS_INTERNAL 0u
#define PRECS_EXTERNAL 1u

/* Durations are right by order of magnitude only. */
#define LOCK_CLOCKS 5000u     /* PLL: 50 us */
#define CRYSTAL_CLOCKS 50000u /* 0.5 ms */
#define SWITCH_CLOCKS 50u
#define ACCESS_CYCLES 4u      /* core cycles per access while booting */
#define REFERENCE_HZ 8000000u /* the internal oscillator, and the crystal of the board */

static bool pll_locked(const occs_t *occs)
{
    return (occs->ctrl & CTRL_PLLPD) == 0 && (occs->ctrl & CTRL_LCKON) != 0 && occs->bus->now >= occs->lock_clock;
}

static bool crystal_good(const occs_t *occs)
{
    return (occs->osctl2 & OSCTL2_COPD) == 0 && occs->bus->now >= occs->crystal_clock;
}

static bool on_pll(const occs_t *occs) { return (occs->ctrl & CTRL_ZSRC) != 0 && occs->bus->now >= occs->switch_clock; }

/* Bus clock: reference times (PLLDB + 1), halved by ZSRC, by the postscaler, and between the fast clock and the bus. */
static uint32_t bus_hz(const occs_t *occs)
{
    uint32_t fast = REFERENCE_HZ;
    if ((occs->ctrl & CTRL_ZSRC) != 0) {
        fast = REFERENCE_HZ * ((occs->divby & 0x3Fu) + 1u) / 2u;
    }
    return (fast >> ((occs->divby >> 8) & 0xFu)) / 2u;
}

static void set_access_time(occs_t *occs)
{
    const uint32_t hz = bus_hz(occs);
    occs->bus->access_clocks = (hz > 0) ? ACCESS_CYCLES * (uint64_t)CHIP_BUS_HZ / hz : ACCESS_CYCLES;
}

void occs_need_bus_clock(occs_t *occs, const char *part)
{
    if (!on_pll(occs) || bus_hz(occs) != CHIP_BUS_HZ) {
        bus_fail(occs->bus, "%s starts while the bus clock is %.3f MHz; only 100 MHz is modelled", part,
                 1e-6 * (double)bus_hz(occs));
    }
}

uint16_t occs_read(void *peripheral, uint32_t address)
{
    occs_t *occs = (occs_t *)peripheral;
    switch (address - OCCS_BASE) {
    case OCCS_CTRL:
        return occs->ctrl;
    case DIVBY:
        return occs->divby;
    case OCCS_STAT: {
        unsigned stat = (occs->bus->now < occs->switch_clock) ? 2u : (occs->ctrl & CTRL_ZSRC);
        stat |= (occs->ctrl & CTRL_PLLPD) != 0 ? 0x0010u : 0u;
        stat |= pll_locked(occs) ? 0x0060u : 0u;
        stat |= crystal_good(occs) ? 0x0080u : 0u;
        return (uint16_t)stat;
    }
    case OSCTL1:
        return occs->osctl1;
    case OSCTL2:
        return occs->osctl2;
    case CLKCHKR:
    case CLKCHKT:
        return 0;
    case OCCS_PROT:
        return occs->prot;
    default:
        bus_no_register(occs->bus, address);
    }
}

static void write_occs_ctrl(occs_t *occs, uint32_t address, uint16_t value)
{
    bus_allow(occs->bus, address, value, 0x009D, "interrupts of the clock generation are not modelled");
    const unsigned source = CTRL_PRECS(value);
    if (source > PRECS_EXTERNAL) {
        bus_no_value(occs->bus, address, value, "this PRECS is not modelled");
    }
    if (source == PRECS_EXTERNAL && source != CTRL_PRECS(occs->ctrl) && !crystal_good(occs)) {
        bus_no_value(occs->bus, address, value, "the external clock is chosen while there is none");
    }
    if ((value & CTRL_PLLPD) == 0 && ((occs->ctrl & CTRL_PLLPD) != 0 || source != CTRL_PRECS(occs->ctrl))) {
        occs->lock_clock = occs->bus->now + LOCK_CLOCKS;
    }
    if (((value ^ occs->ctrl) & CTRL_ZSRC) != 0) {
        if ((value & CTRL_ZSRC) != 0 && !pll_locked(occs)) {
            bus_no_value(occs->bus, address, value, "the PLL is chosen before it has locked");
        }
        occs->switch_clock = occs->bus->now + SWITCH_CLOCKS;
    }
    occs->ctrl = value;
    set_access_time(occs);
}

void occs_write(void *peripheral, uint32_t address, uint16_t value)
{
    occs_t *occs = (occs_t *)peripheral;
    if ((occs->prot & 3u) != 0 && address - OCCS_BASE <= DIVBY) {
        return; /* protected */
    }
    if ((occs->prot & 0x0Cu) != 0 && (address - OCCS_BASE == OSCTL1 || address - OCCS_BASE == OSCTL2)) {
        return;
    }
    switch (address - OCCS_BASE) {
    case OCCS_CTRL:
        write_occs_ctrl(occs, address, value);
        break;
    case DIVBY:
        if ((value & 0x003Fu) != (occs->divby & 0x003Fu)) {
            if ((occs->ctrl & CTRL_ZSRC) != 0) {
                bus_no_value(occs->bus, address, value, "PLLDB changes while the core runs on the PLL");
            }
            occs->lock_clock = occs->bus->now + LOCK_CLOCKS;
        }
        occs->divby = value;
        set_access_time(occs);
        break;
    case OCCS_STAT:
        break; /* interrupts are never set */
    case OSCTL1:
        if ((value & OSCTL1_ROPD) != 0 && CTRL_PRECS(occs->ctrl) == PRECS_INTERNAL) {
            bus_no_value(occs->bus, address, value, "the oscillator in use is switched off");
        }
        occs->osctl1 = value;
        break;
    case OSCTL2:
        if ((occs->osctl2 & OSCTL2_COPD) != 0 && (value & OSCTL2_COPD) == 0) {
            occs->crystal_clock = occs->bus->now + CRYSTAL_CLOCKS;
        }
        occs->osctl2 = value;
        break;
    case CLKCHKR:
    case CLKCHKT:
        bus_allow(occs->bus, address, value, 0, "the clock check is not modelled");
        break;
    case OCCS_PROT:
        occs->prot = value;
        break;
    default:
        bus_no_register(occs->bus, address);
    }
}

void occs_reset(void *peripheral)
{
    occs_t *occs = (occs_t *)peripheral;
    *occs = (occs_t){.bus = occs->bus, .ctrl = CTRL_PLLPD, .divby = 0x2031, .osctl2 = OSCTL2_COPD};
    set_access_time(occs);
}
