#include "chip/intc.h"

#define VBA 0xE30Du
#define FIM0 0xE30Eu
#define IRQP0 0xE314u
#define INTC_CTRL 0xE31Bu
#define INTC_CTRL_INT_DIS 0x0020u

/* Peripherals have their fields in the order of their vectors; code c is level c - 1 from the timers on. */
static void enable_vectors(intc_t *intc)
{
    for (int level = 0; level < INTC_LEVELS; level++) {
        intc->enabled[level][0] = intc->enabled[level][1] = 0;
    }
    for (unsigned vector = VECTOR_TMRB3; vector <= VECTOR_COP; vector++) {
        const unsigned index = vector - 9u;
        const unsigned code = (intc->ipr[index / 8u] >> (2u * (index % 8u))) & 3u;
        if (code > 0) {
            intc->enabled[code - 1u][vector >> 6] |= UINT64_C(1) << (vector & 63u);
        }
    }
    intc->bus->changed = true;
}

uint16_t intc_read(void *peripheral, uint32_t address)
{
    intc_t *intc = (intc_t *)peripheral;
    if (address < VBA) {
        return intc->ipr[address - INTC_BASE];
    }
    if (address == VBA) {
        return intc->vba;
    }
    if (address >= IRQP0 && address < INTC_CTRL) {
        const unsigned first = (address - IRQP0) * 16u;
        uint16_t pending = 0xFFFF; /* active low */
        for (unsigned bit = 0; bit < 16u && first + bit < INTC_VECTORS; bit++) {
            const unsigned vector = first + bit;
            if (((intc->bus->request[vector >> 6] >> (vector & 63u)) & 1u) != 0) {
                pending = (uint16_t)(pending & ~(1u << bit));
            }
        }
        return pending;
    }
    if (address == INTC_CTRL) {
        return intc->ctrl;
    }
    bus_no_register(intc->bus, address);
}

void intc_write(void *peripheral, uint32_t address, uint16_t value)
{
    intc_t *intc = (intc_t *)peripheral;
    if (address < VBA) {
        intc->ipr[address - INTC_BASE] = value;
        enable_vectors(intc);
    } else if (address == VBA) {
        intc->vba = value & 0x1FFFu;
    } else if (address >= FIM0 && address < IRQP0) {
        bus_allow(intc->bus, address, value, 0, "fast interrupts are not modelled");
    } else if (address == INTC_CTRL) {
        intc->ctrl = value & INTC_CTRL_INT_DIS;
        intc->bus->changed = true;
    } else {
        bus_no_register(intc->bus, address);
    }
}

bool intc_most_urgent(const intc_t *intc, int level, unsigned *vector, int *its_level)
{
    if ((intc->ctrl & INTC_CTRL_INT_DIS) != 0) {
        return false;
    }
    for (int l = INTC_LEVELS - 1; l > level; l--) {
        for (unsigned word = 0; word < 2u; word++) {
            const uint64_t pending = intc->bus->request[word] & intc->enabled[l][word];
            if (pending != 0) {
                *vector = 64u * word + lowest_bit(pending);
                *its_level = l;
                return true;
            }
        }
    }
    return false;
}

void intc_reset(void *peripheral)
{
    intc_t *intc = (intc_t *)peripheral;
    bus_t *bus = intc->bus;
    *intc = (intc_t){.bus = bus};
    bus->request[0] = bus->request[1] = 0;
    bus->changed = true;
}
