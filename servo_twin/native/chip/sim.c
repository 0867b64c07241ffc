#include "chip/sim.h"
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

uint16_t sim_read(void *peripheral, uint32_t address)
{
    sim_t *sim = (sim_t *)peripheral;
    const uint32_t number = address - SIM_BASE;
    if (number >= SCR0 && number <= SCR3) {
        return sim->scr[number - SCR0];
    }
    if (number >= PCE0 && number <= PCE3) {
        return sim->bus->sim.pce[number - PCE0];
    }
    if (number >= SD0 && number <= SD3) {
        return sim->sd[number - SD0];
    }
    if (number >= GPSAL && number <= GPSGH) {
        return sim->bus->sim.gps[number - GPSAL];
    }
    switch (number) {
    case SIM_CTRL:
        return sim->ctrl;
    case RSTAT:
        return sim->rstat;
    case SIM_PCR:
        return sim->bus->sim.pcr;
    case SIM_PROT:
        return sim->prot;
    case IPS0:
        return sim->bus->sim.ips0;
    case MISC0:
        return sim->misc0;
    case PWRMODE:
        return sim->pwrmode;
    case NVMOPT2H:
        return 0x1E00; /* factory trims: the middle of their ranges */
    case NVMOPT2L:
        return 0x0100;
    default:
        bus_no_register(sim->bus, address);
    }
}

void sim_write(void *peripheral, uint32_t address, uint16_t value)
{
    sim_t *sim = (sim_t *)peripheral;
    const uint32_t number = address - SIM_BASE;
    if (((sim->prot >> 2) & 3u) != 0 && number >= PCE0 && number <= SD3) {
        return; /* protected */
    }
    if ((sim->prot & 3u) != 0 && number >= GPSAL && number <= IPS0) {
        return;
    }
    if (number >= SCR0 && number <= SCR3) {
        sim->scr[number - SCR0] = value;
        return;
    }
    if (number >= PCE0 && number <= PCE3) {
        sim->bus->sim.pce[number - PCE0] = value;
        sim->bus->signals->clock_gates_changed(sim->bus->chip);
        return;
    }
    if (number >= SD0 && number <= SD3) {
        sim->sd[number - SD0] = value;
        return;
    }
    if (number >= GPSAL && number <= GPSGH) {
        sim->bus->sim.gps[number - GPSAL] = value;
        sim->bus->signals->route_pins(sim->bus->chip);
        return;
    }
    switch (number) {
    case SIM_CTRL:
        if ((value & SIM_CTRL_SWRST) != 0) {
            sim->bus->signals->reset(sim->bus->chip, RESET_SOFTWARE);
        }
        sim->ctrl = value;
        break;
    case RSTAT:
        sim->rstat = (uint16_t)(sim->rstat & ~value);
        break;
    case SIM_PCR:
        sim->bus->sim.pcr = value & 0x3800u;
        break;
    case SIM_PROT:
        sim->prot = value;
        break;
    case IPS0:
        sim->bus->signals->timer_catch_up(sim->bus->chip); /* from the inputs before this change */
        sim->bus->sim.ips0 = value;
        sim->bus->signals->route_pins(sim->bus->chip);
        break;
    case MISC0:
        bus_allow(sim->bus, address, value, 0x0002, "linked interval timers are not modelled");
        sim->misc0 = value;
        break;
    case PWRMODE:
        bus_allow(sim->bus, address, value, 0, "low-power modes are not modelled");
        break;
    default:
        bus_no_register(sim->bus, address);
    }
}

void sim_reset(void *peripheral)
{
    sim_t *sim = (sim_t *)peripheral;
    *sim = (sim_t){.bus = sim->bus, .cause = sim->cause, .rstat = (uint16_t)sim->cause};
    sim->bus->sim = (sim_control_t){.pcr = 0};
}
