#include "chip/system.h"

#include "chip/parts.h"

/* ---- OCCS ------------------------------------------------------------------------------------------------------------ */

#define OCCS_BASE 0xE2B0u

enum { OCCS_CTRL, DIVBY, OCCS_STAT, OSCTL1 = 4, OSCTL2, CLKCHKR, CLKCHKT, OCCS_PROT };

#define CTRL_ZSRC 0x0001u
#define CTRL_PRECS(x) (((x) >> 2) & 3u)
#define CTRL_PLLPD 0x0010u
#define CTRL_LCKON 0x0080u
#define OSCTL1_ROPD 0x8000u
#define OSCTL2_COPD 0x4000u
#define PRECS_INTERNAL 0u
#define PRECS_EXTERNAL 1u

/* What silicon takes some time for; the figures are only of the right order. */
#define LOCK_CLOCKS 5000u     /* PLL: 50 us */
#define CRYSTAL_CLOCKS 50000u /* 0.5 ms */
#define SWITCH_CLOCKS 50u
#define ACCESS_CYCLES 4u      /* core cycles per access while booting */
#define REFERENCE_HZ 8000000u /* the internal oscillator, and the crystal of the board */

static bool pll_locked(const chip_t *chip)
{
    const occs_t *occs = &chip->occs;
    return (occs->ctrl & CTRL_PLLPD) == 0 && (occs->ctrl & CTRL_LCKON) != 0 && chip->now >= occs->lock_clock;
}

static bool crystal_good(const chip_t *chip)
{
    return (chip->occs.osctl2 & OSCTL2_COPD) == 0 && chip->now >= chip->occs.crystal_clock;
}

static bool on_pll(const chip_t *chip)
{
    return (chip->occs.ctrl & CTRL_ZSRC) != 0 && chip->now >= chip->occs.switch_clock;
}

/* Bus clock: reference times (PLLDB + 1), halved by ZSRC, by the postscaler, and between the fast clock and the bus. */
static uint32_t bus_hz(const chip_t *chip)
{
    const occs_t *occs = &chip->occs;
    uint32_t fast = REFERENCE_HZ;
    if ((occs->ctrl & CTRL_ZSRC) != 0) {
        fast = REFERENCE_HZ * ((occs->divby & 0x3Fu) + 1u) / 2u;
    }
    return (fast >> ((occs->divby >> 8) & 0xFu)) / 2u;
}

static void pace(chip_t *chip)
{
    const uint32_t hz = bus_hz(chip);
    chip->core.access_clocks = (hz > 0) ? ACCESS_CYCLES * (uint64_t)CHIP_BUS_HZ / hz : ACCESS_CYCLES;
}

void occs_need_bus_clock(chip_t *chip, const char *what)
{
    if (!on_pll(chip) || bus_hz(chip) != CHIP_BUS_HZ) {
        chip_fail(chip, "%s starts while the bus clock is %.3f MHz; only 100 MHz is modelled", what,
                  1e-6 * (double)bus_hz(chip));
    }
}

uint16_t occs_read(chip_t *chip, uint32_t address)
{
    const occs_t *occs = &chip->occs;
    switch (address - OCCS_BASE) {
    case OCCS_CTRL:
        return occs->ctrl;
    case DIVBY:
        return occs->divby;
    case OCCS_STAT: {
        unsigned stat = (chip->now < occs->switch_clock) ? 2u : (occs->ctrl & CTRL_ZSRC);
        stat |= (occs->ctrl & CTRL_PLLPD) != 0 ? 0x0010u : 0u;
        stat |= pll_locked(chip) ? 0x0060u : 0u;
        stat |= crystal_good(chip) ? 0x0080u : 0u;
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
        chip_no_register(chip, address);
    }
}

static void write_occs_ctrl(chip_t *chip, uint32_t address, uint16_t value)
{
    occs_t *occs = &chip->occs;
    chip_only(chip, address, value, 0x009D, "interrupts of the clock generation are not modelled");
    const unsigned source = CTRL_PRECS(value);
    if (source > PRECS_EXTERNAL) {
        chip_no_value(chip, address, value, "this PRECS is not modelled");
    }
    if (source == PRECS_EXTERNAL && source != CTRL_PRECS(occs->ctrl) && !crystal_good(chip)) {
        chip_no_value(chip, address, value, "the external clock is chosen while there is none");
    }
    if ((value & CTRL_PLLPD) == 0 && ((occs->ctrl & CTRL_PLLPD) != 0 || source != CTRL_PRECS(occs->ctrl))) {
        occs->lock_clock = chip->now + LOCK_CLOCKS;
    }
    if (((value ^ occs->ctrl) & CTRL_ZSRC) != 0) {
        if ((value & CTRL_ZSRC) != 0 && !pll_locked(chip)) {
            chip_no_value(chip, address, value, "the PLL is chosen before it has locked");
        }
        occs->switch_clock = chip->now + SWITCH_CLOCKS;
    }
    occs->ctrl = value;
    pace(chip);
}

void occs_write(chip_t *chip, uint32_t address, uint16_t value)
{
    occs_t *occs = &chip->occs;
    if ((occs->prot & 3u) != 0 && address - OCCS_BASE <= DIVBY) {
        return; /* protected */
    }
    if ((occs->prot & 0x0Cu) != 0 && (address - OCCS_BASE == OSCTL1 || address - OCCS_BASE == OSCTL2)) {
        return;
    }
    switch (address - OCCS_BASE) {
    case OCCS_CTRL:
        write_occs_ctrl(chip, address, value);
        break;
    case DIVBY:
        if ((value & 0x003Fu) != (occs->divby & 0x003Fu)) {
            if ((occs->ctrl & CTRL_ZSRC) != 0) {
                chip_no_value(chip, address, value, "PLLDB changes while the core runs on the PLL");
            }
            occs->lock_clock = chip->now + LOCK_CLOCKS;
        }
        occs->divby = value;
        pace(chip);
        break;
    case OCCS_STAT:
        break; /* clears interrupts that are never set */
    case OSCTL1:
        if ((value & OSCTL1_ROPD) != 0 && CTRL_PRECS(occs->ctrl) == PRECS_INTERNAL) {
            chip_no_value(chip, address, value, "the oscillator in use is switched off");
        }
        occs->osctl1 = value;
        break;
    case OSCTL2:
        if ((occs->osctl2 & OSCTL2_COPD) != 0 && (value & OSCTL2_COPD) == 0) {
            occs->crystal_clock = chip->now + CRYSTAL_CLOCKS;
        }
        occs->osctl2 = value;
        break;
    case CLKCHKR:
    case CLKCHKT:
        chip_only(chip, address, value, 0, "the clock check is not modelled");
        break;
    case OCCS_PROT:
        occs->prot = value;
        break;
    default:
        chip_no_register(chip, address);
    }
}

/* ---- SIM ------------------------------------------------------------------------------------------------------------- */

#define SIM_BASE 0xE400u

enum {
    SIM_CTRL,
    RSTAT,
    SCR0,
    SCR3 = 5,
    SIM_PCR = 0x0B,
    PCE0,
    PCE3 = 0x0F,
    SD0,
    SD3 = 0x13,
    SIM_PROT = 0x16,
    GPSAL,
    GPSGH = 0x21,
    IPS0,
    MISC0,
    PSWR0,
    PSWR3 = 0x27,
    PWRMODE,
    NVMOPT2H = 0x2C,
    NVMOPT2L
};

#define SIM_CTRL_SWRST 0x0010u

void sim_gate_closed(chip_t *chip, uint32_t address, unsigned index, unsigned bit)
{
    char name[64];
    chip_register_name(address, name, sizeof name);
    chip_fail(chip, "%s is accessed while its clock is gated off (SIM_PCE%u bit %u)", name, index, bit);
}

uint16_t sim_read(chip_t *chip, uint32_t address)
{
    const sim_t *sim = &chip->sim;
    const uint32_t r = address - SIM_BASE;
    if (r >= SCR0 && r <= SCR3) {
        return sim->scr[r - SCR0];
    }
    if (r >= PCE0 && r <= PCE3) {
        return sim->pce[r - PCE0];
    }
    if (r >= SD0 && r <= SD3) {
        return sim->sd[r - SD0];
    }
    if (r >= GPSAL && r <= GPSGH) {
        return chip->pins.select[r - GPSAL];
    }
    switch (r) {
    case SIM_CTRL:
        return sim->ctrl;
    case RSTAT:
        return sim->rstat;
    case SIM_PCR:
        return sim->pcr;
    case SIM_PROT:
        return sim->prot;
    case IPS0:
        return sim->ips0;
    case MISC0:
        return sim->misc0;
    case PWRMODE:
        return sim->pwrmode;
    case NVMOPT2H:
        return 0x1E00; /* factory trims: the middle of their ranges */
    case NVMOPT2L:
        return 0x0100;
    default:
        chip_no_register(chip, address);
    }
}

void sim_write(chip_t *chip, uint32_t address, uint16_t value)
{
    sim_t *sim = &chip->sim;
    const uint32_t r = address - SIM_BASE;
    if (((sim->prot >> 2) & 3u) != 0 && r >= PCE0 && r <= SD3) {
        return; /* protected */
    }
    if ((sim->prot & 3u) != 0 && r >= GPSAL && r <= IPS0) {
        return;
    }
    if (r >= SCR0 && r <= SCR3) {
        sim->scr[r - SCR0] = value;
        return;
    }
    if (r >= PCE0 && r <= PCE3) {
        sim->pce[r - PCE0] = value;
        pwm_gates_changed(chip);
        qtmr_gates_changed(chip);
        return;
    }
    if (r >= SD0 && r <= SD3) {
        sim->sd[r - SD0] = value;
        return;
    }
    if (r >= GPSAL && r <= GPSGH) {
        chip->pins.select[r - GPSAL] = value;
        pins_reroute(chip);
        return;
    }
    switch (r) {
    case SIM_CTRL:
        if ((value & SIM_CTRL_SWRST) != 0) {
            chip_reset(chip, RESET_SOFTWARE);
        }
        sim->ctrl = value;
        break;
    case RSTAT:
        sim->rstat = (uint16_t)(sim->rstat & ~value);
        break;
    case SIM_PCR:
        sim->pcr = value & 0x3800u;
        break;
    case SIM_PROT:
        sim->prot = value;
        break;
    case IPS0:
        qtmr_catch_up(chip); /* by the way that inputs had so far */
        sim->ips0 = value;
        pins_reroute(chip);
        break;
    case MISC0:
        chip_only(chip, address, value, 0x0002, "linked interval timers are not modelled");
        sim->misc0 = value;
        break;
    case PWRMODE:
        chip_only(chip, address, value, 0, "low-power modes are not modelled");
        break;
    default:
        chip_no_register(chip, address);
    }
}

/* ---- COP ------------------------------------------------------------------------------------------------------------- */

#define COP_BASE 0xE320u

enum { COP_CTRL, TOUT, COP_CNTR, INTVAL };

#define COP_CWP 0x0001u
#define COP_CEN 0x0002u
#define COP_CLKSEL(x) (((x) >> 5) & 3u)
#define COP_PSS(x) (((x) >> 8) & 3u)
#define COP_FIRST_WORD 0x5555u
#define COP_SECOND_WORD 0xAAAAu

/* Bus clocks per count. */
static uint64_t cop_count_clocks(const chip_t *chip)
{
    static const uint32_t source_hz[4] = {8000000u, REFERENCE_HZ, CHIP_BUS_HZ, 32768u};
    static const uint32_t prescaler[4] = {1u, 16u, 256u, 1024u};
    const uint16_t ctrl = chip->cop.ctrl;
    return ((uint64_t)CHIP_BUS_HZ * prescaler[COP_PSS(ctrl)] + source_hz[COP_CLKSEL(ctrl)] / 2u) /
           source_hz[COP_CLKSEL(ctrl)];
}

static void cop_restart(chip_t *chip)
{
    cop_t *cop = &chip->cop;
    cop->start_clock = chip->now;
    cop->half_served = false;
    chip_schedule(chip, SOURCE_COP,
                  ((cop->ctrl & COP_CEN) != 0) ? chip->now + ((uint64_t)cop->tout + 1u) * cop_count_clocks(chip)
                                               : CHIP_NEVER);
}

void cop_event(chip_t *chip)
{
    if (chip_is_due(chip, SOURCE_COP)) {
        chip_reset(chip, RESET_COP);
    }
}

uint16_t cop_read(chip_t *chip, uint32_t address)
{
    const cop_t *cop = &chip->cop;
    switch (address - COP_BASE) {
    case COP_CTRL:
        return cop->ctrl;
    case TOUT:
        return cop->tout;
    case COP_CNTR:
        return ((cop->ctrl & COP_CEN) != 0)
                   ? (uint16_t)(cop->tout - (chip->now - cop->start_clock) / cop_count_clocks(chip))
                   : cop->tout;
    default:
        return cop->intval;
    }
}

void cop_write(chip_t *chip, uint32_t address, uint16_t value)
{
    cop_t *cop = &chip->cop;
    const uint32_t r = address - COP_BASE;
    const bool locked = (cop->ctrl & COP_CWP) != 0;
    if (r == COP_CNTR) {
        if (value == COP_SECOND_WORD && cop->half_served) {
            cop->services++;
            cop_restart(chip);
        } else {
            cop->half_served = value == COP_FIRST_WORD;
        }
    } else if (locked) {
        return;
    } else if (r == COP_CTRL) {
        chip_only(chip, address, value, 0x037F, "the interrupt of the watchdog is not modelled");
        const bool same = ((value ^ cop->ctrl) & ~COP_CWP) == 0;
        cop->ctrl = value;
        if (!same) {
            cop_restart(chip);
        }
    } else if (r == TOUT) {
        if ((cop->ctrl & COP_CEN) != 0) {
            chip_no_value(chip, address, value, "TOUT changes while the watchdog counts");
        }
        cop->tout = value;
    } else {
        cop->intval = value;
    }
}

/* ---- reset ----------------------------------------------------------------------------------------------------------- */

void system_reset(chip_t *chip, reset_cause_t cause)
{
    const uint32_t services = chip->cop.services;
    chip->occs = (occs_t){.ctrl = CTRL_PLLPD, .divby = 0x2031, .osctl2 = OSCTL2_COPD};
    chip->sim = (sim_t){.rstat = (uint16_t)cause};
    chip->cop = (cop_t){.ctrl = COP_CEN | 0x0300u, .tout = 0xFFFF, .intval = 0x00FF, .services = services};
    for (unsigned i = 0; i < GPIO_PORTS; i++) {
        chip->pins.port[i] = (gpio_port_t){.peripheral = 0};
    }
    for (unsigned i = 0; i < sizeof chip->pins.select / sizeof chip->pins.select[0]; i++) {
        chip->pins.select[i] = 0;
    }
    pace(chip);
    cop_restart(chip);
}
