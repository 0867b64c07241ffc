#include "chip/bus.h"

#include <stdarg.h>
#include <stdio.h>

#define NAME_SIZE 64

void bus_fail(bus_t *bus, const char *format, ...)
{
    if (!bus->failed) {
        char text[CHIP_ERROR_SIZE];
        va_list arguments;
        va_start(arguments, format);
        (void)vsnprintf(text, sizeof text, format, arguments);
        va_end(arguments);
        (void)snprintf(bus->error, sizeof bus->error, "%.150s (at %.2f us)", text, (double)bus->now / BOARD_CLOCK_MHZ);
    }
    bus->failed = true;
    longjmp(bus->escape, ESCAPE_FAILURE);
}

void bus_no_register(bus_t *bus, uint32_t address)
{
    char name[NAME_SIZE];
    chip_register_name(address, name, sizeof name);
    bus_fail(bus, "%s (%04lXh) is not modelled", name, (unsigned long)address);
}

void bus_no_value(bus_t *bus, uint32_t address, uint16_t value, const char *why)
{
    char name[NAME_SIZE];
    chip_register_name(address, name, sizeof name);
    bus_fail(bus, "%s = %04Xh: %s", name, (unsigned)value, why);
}

void bus_gate_closed(bus_t *bus, uint32_t address, unsigned index, unsigned bit)
{
    char name[NAME_SIZE];
    chip_register_name(address, name, sizeof name);
    bus_fail(bus, "%s is accessed while its clock is gated off (SIM_PCE%u bit %u)", name, index, bit);
}
