#include "chip/pins.h"

enum { PUR, DR, DDR, PER, IAR, IENR, IPOLR, IPR, IESR, PPMODE, RAWDATA, DRIVE, PUS, SRE };

/* ---- functions ------------------------------------------------------------------------------------------------------- */

#define GATE(module, submodule, side) (FUNCTION_PWM_A0A + 8 * (module) + 2 * (submodule) + (side))
#define FAULT(module, input) (FUNCTION_FAULT_A0 + 8 * (module) + (input))
#define TA(n) (FUNCTION_TIMER_A0 + (n))
#define TB(n) (FUNCTION_TIMER_A0 + 4 + (n))
#define TXD(n) (FUNCTION_TXD0 + (n))
#define RXD(n) (FUNCTION_RXD0 + (n))
#define XB_IN(n) (FUNCTION_XB_IN2 + (n) - 2)
#define OTHER FUNCTION_OTHER

typedef struct {
    uint8_t pin, select, shift, width; /* field in SIM_GPSxx: register, position, bits (0: a single function) */
    uint8_t function[4];
} choice_t;

/* GPSAL 0, GPSBH 1, GPSCL 2, GPSCH 3, GPSDL 4, GPSEL 5, GPSEH 6, GPSFL 7, GPSFH 8, GPSGL 9, GPSGH 10. Pins that are not
 * listed have no function that is modelled. */
static const choice_t choices[] = {
    {CHIP_PIN('A', 0), 0, 0, 1, {FUNCTION_ANALOG, OTHER}},
    {CHIP_PIN('B', 9), 1, 2, 2, {OTHER, XB_IN(9), OTHER}},
    {CHIP_PIN('B', 10), 1, 4, 2, {OTHER, XB_IN(8), OTHER}},
    {CHIP_PIN('B', 11), 1, 6, 2, {OTHER, XB_IN(7), OTHER}},
    {CHIP_PIN('C', 2), 2, 4, 2, {TXD(0), TB(0), XB_IN(2), OTHER}},
    {CHIP_PIN('C', 3), 2, 6, 2, {TA(0), OTHER, RXD(0), OTHER}},
    {CHIP_PIN('C', 4), 2, 8, 2, {TA(1), OTHER, XB_IN(8), OTHER}},
    {CHIP_PIN('C', 5), 2, 10, 1, {OTHER, XB_IN(7)}},
    {CHIP_PIN('C', 6), 2, 12, 2, {TA(2), XB_IN(3), OTHER}},
    {CHIP_PIN('C', 7), 2, 14, 1, {OTHER, TXD(0)}},
    {CHIP_PIN('C', 8), 3, 0, 2, {OTHER, RXD(0), XB_IN(9)}},
    {CHIP_PIN('C', 9), 3, 2, 1, {OTHER, XB_IN(4)}},
    {CHIP_PIN('C', 10), 3, 4, 2, {OTHER, XB_IN(5), OTHER}},
    {CHIP_PIN('C', 11), 3, 6, 2, {OTHER, OTHER, TXD(1)}},
    {CHIP_PIN('C', 12), 3, 8, 2, {OTHER, OTHER, RXD(1)}},
    {CHIP_PIN('C', 13), 3, 10, 2, {TA(3), XB_IN(6), OTHER}},
    {CHIP_PIN('D', 5), 4, 10, 2, {RXD(2), XB_IN(5), OTHER}},
    {CHIP_PIN('D', 6), 4, 12, 2, {TXD(2), XB_IN(4), OTHER}},
    {CHIP_PIN('D', 7), 4, 14, 2, {OTHER, XB_IN(7), OTHER}},
    {CHIP_PIN('E', 0), 0, 0, 0, {GATE(0, 0, 1)}},
    {CHIP_PIN('E', 1), 0, 0, 0, {GATE(0, 0, 0)}},
    {CHIP_PIN('E', 2), 0, 0, 0, {GATE(0, 1, 1)}},
    {CHIP_PIN('E', 3), 0, 0, 0, {GATE(0, 1, 0)}},
    {CHIP_PIN('E', 4), 5, 8, 1, {GATE(0, 2, 1), XB_IN(2)}},
    {CHIP_PIN('E', 5), 5, 10, 1, {GATE(0, 2, 0), XB_IN(3)}},
    {CHIP_PIN('E', 6), 5, 12, 2, {GATE(0, 3, 1), XB_IN(4), GATE(1, 2, 1)}},
    {CHIP_PIN('E', 7), 5, 14, 2, {GATE(0, 3, 0), XB_IN(5), GATE(1, 2, 0)}},
    {CHIP_PIN('E', 8), 6, 0, 1, {GATE(1, 2, 1), FAULT(0, 0)}},
    {CHIP_PIN('E', 9), 6, 2, 1, {GATE(1, 2, 0), FAULT(0, 1)}},
    {CHIP_PIN('F', 0), 7, 0, 2, {XB_IN(6), TB(2), OTHER}},
    {CHIP_PIN('F', 1), 7, 2, 2, {OTHER, XB_IN(7), OTHER}},
    {CHIP_PIN('F', 4), 7, 8, 1, {TXD(1), OTHER}},
    {CHIP_PIN('F', 5), 7, 10, 1, {RXD(1), OTHER}},
    {CHIP_PIN('F', 6), 7, 12, 2, {TB(2), OTHER, OTHER, XB_IN(2)}},
    {CHIP_PIN('F', 7), 7, 14, 2, {TB(3), OTHER, OTHER, XB_IN(3)}},
    {CHIP_PIN('F', 8), 8, 0, 2, {RXD(0), TB(1), OTHER}},
    {CHIP_PIN('F', 9), 8, 2, 2, {RXD(2), OTHER, OTHER, OTHER}},
    {CHIP_PIN('F', 10), 8, 4, 2, {TXD(2), OTHER, OTHER, OTHER}},
    {CHIP_PIN('F', 11), 8, 6, 1, {TXD(0), XB_IN(11)}},
    {CHIP_PIN('F', 12), 8, 8, 1, {OTHER, FAULT(1, 2)}},
    {CHIP_PIN('F', 13), 8, 10, 1, {OTHER, FAULT(1, 1)}},
    {CHIP_PIN('F', 14), 8, 12, 1, {OTHER, FAULT(1, 0)}},
    {CHIP_PIN('F', 15), 8, 14, 1, {RXD(0), XB_IN(10)}},
    {CHIP_PIN('G', 0), 9, 0, 1, {GATE(1, 1, 1), OTHER}},
    {CHIP_PIN('G', 1), 9, 2, 1, {GATE(1, 1, 0), OTHER}},
    {CHIP_PIN('G', 2), 9, 4, 1, {GATE(1, 0, 1), OTHER}},
    {CHIP_PIN('G', 3), 9, 6, 1, {GATE(1, 0, 0), OTHER}},
    {CHIP_PIN('G', 4), 9, 8, 1, {GATE(1, 3, 1), FAULT(0, 2)}},
    {CHIP_PIN('G', 5), 9, 10, 1, {GATE(1, 3, 0), FAULT(0, 3)}},
    {CHIP_PIN('G', 6), 9, 12, 2, {OTHER, OTHER, TB(2), OTHER}},
    {CHIP_PIN('G', 8), 10, 0, 2, {OTHER, OTHER, TA(2), OTHER}},
    {CHIP_PIN('G', 9), 10, 2, 2, {OTHER, OTHER, TA(3), OTHER}},
    {CHIP_PIN('G', 10), 10, 4, 2, {OTHER, OTHER, XB_IN(8), OTHER}},
    {CHIP_PIN('G', 11), 10, 6, 2, {TB(3), OTHER, OTHER}},
};

#define CHOICES (sizeof choices / sizeof choices[0])

static bool is_peripheral(const pins_t *pins, unsigned pin)
{
    return ((pins->port[pin >> 4].reg[PER] >> (pin & 15u)) & 1u) != 0;
}

static pin_function_t selected(const pins_t *pins, const choice_t *choice)
{
    if (!is_peripheral(pins, choice->pin)) {
        return FUNCTION_GPIO;
    }
    const unsigned code =
        ((unsigned)pins->bus->sim.gps[choice->select] >> choice->shift) & ((1u << choice->width) - 1u);
    const pin_function_t function = (pin_function_t)choice->function[code];
    return (function == FUNCTION_GPIO) ? FUNCTION_OTHER : function; /* an entry left out: a reserved code */
}

static pin_function_t find_function(const pins_t *pins, unsigned pin)
{
    for (unsigned i = 0; i < CHOICES; i++) {
        if (choices[i].pin == pin) {
            return selected(pins, &choices[i]);
        }
    }
    const bool analog = pin < CHIP_PIN('C', 0) && (pin & 15u) < 8u;
    return !is_peripheral(pins, pin) ? FUNCTION_GPIO : analog ? FUNCTION_ANALOG : FUNCTION_OTHER;
}

static pin_function_t function_of(const pins_t *pins, unsigned pin)
{
    return (pin < CHIP_PINS) ? (pin_function_t)pins->function[pin] : FUNCTION_OTHER;
}

/* The SCI that has a pin; `first` is the function of that pin for SCI0. */
static unsigned sci_of(const pins_t *pins, unsigned pin, unsigned first)
{
    const unsigned module = (unsigned)function_of(pins, pin) - first;
    return (module < SCI_MODULES) ? module : SCI_MODULES;
}

unsigned pins_sender(const pins_t *pins) { return sci_of(pins, pins->wiring.txd, FUNCTION_TXD0); }

unsigned pins_receiver(const pins_t *pins) { return sci_of(pins, pins->wiring.rxd, FUNCTION_RXD0); }

gate_pin_t pins_gate(const pins_t *pins, unsigned module, unsigned submodule, unsigned side)
{
    const unsigned pin = pins->wiring.gate[module][submodule][side];
    const pin_function_t function = function_of(pins, pin);
    if (function == FUNCTION_GPIO) {
        const gpio_port_t *port = &pins->port[pin >> 4];
        return ((port->reg[DDR] & port->reg[DR]) >> (pin & 15u) & 1) != 0 ? GATE_HIGH : GATE_LOW;
    }
    return (function == (pin_function_t)GATE(module, submodule, side)) ? GATE_PWM : GATE_LOW;
}

/* ---- inputs ---------------------------------------------------------------------------------------------------------- */

static bool level_of(const pins_t *pins, unsigned pin) { return ((pins->in[pin >> 4] >> (pin & 15u)) & 1u) != 0; }

void pins_set_late(pins_t *pins, unsigned pin, bool level)
{
    uint16_t *in = &pins->in[pin >> 4];
    const unsigned bit = 1u << (pin & 15u);
    *in = (uint16_t)(level ? (*in | bit) : (*in & ~bit));
}

/* Input of a timer or of the fault logic comes from its pin, unless SIM_IPS0 gives it to the crossbar. */
static bool from_crossbar(const pins_t *pins, unsigned bit) { return ((pins->bus->sim.ips0 >> bit) & 1u) != 0; }

static unsigned timer_input(const pins_t *pins, pin_function_t function)
{
    const unsigned i = (unsigned)function - FUNCTION_TIMER_A0;
    return (i < PINS_TIMER_INPUTS && !from_crossbar(pins, 8u + i)) ? i : PINS_TIMER_INPUTS;
}

unsigned pins_timer_input(const pins_t *pins, unsigned pin) { return timer_input(pins, function_of(pins, pin)); }

/* Inputs XB_IN2 to XB_IN11 of crossbar A, some of which go to crossbar B, too. */
static void set_crossbar(pins_t *pins, unsigned n, bool level)
{
    const int b = (n == 2u) ? 14 : (n == 3u) ? 15 : (n == 10u) ? 20 : (n == 11u) ? 21 : -1;
    if (((pins->xb_in >> n) & 1u) != (level ? 1u : 0u)) {
        pins->xb_in ^= 1u << n;
        pins->bus->signals->crossbar(pins->bus->chip, (int)n, b, level ? XBAR_RISE : XBAR_FALL);
    }
}

/* Level at the peripheral that has a function. */
static void set_input(pins_t *pins, pin_function_t function, bool level)
{
    const chip_signals_t *signals = pins->bus->signals;
    const unsigned timer = timer_input(pins, function);
    if (timer != PINS_TIMER_INPUTS) {
        signals->timer_input(pins->bus->chip, timer / QTMR_CHANNELS, timer % QTMR_CHANNELS, level);
    } else if (function >= FUNCTION_FAULT_A0 && function < FUNCTION_TIMER_A0) {
        const unsigned i = (unsigned)(function - FUNCTION_FAULT_A0);
        if ((i & 7u) < PWM_FAULTS && !from_crossbar(pins, (i / 8u) * 4u + (i & 7u))) {
            signals->pwm_fault(pins->bus->chip, i / 8u, i & 7u, level);
        }
    } else if (function >= FUNCTION_XB_IN2 && function < FUNCTION_COUNT) {
        set_crossbar(pins, (unsigned)(function - FUNCTION_XB_IN2) + 2u, level);
    }
}

void pins_set(pins_t *pins, unsigned pin, bool level)
{
    pins_set_late(pins, pin, level);
    set_input(pins, function_of(pins, pin), level);
}

/* ---- routing --------------------------------------------------------------------------------------------------------- */

void pins_route(pins_t *pins)
{
    uint8_t before[CHIP_PINS];
    const chip_signals_t *signals = pins->bus->signals;
    signals->timer_catch_up(pins->bus->chip);
    for (unsigned pin = 0; pin < CHIP_PINS; pin++) {
        before[pin] = pins->function[pin];
        pins->function[pin] = (uint8_t)find_function(pins, pin);
    }
    pins->analog = 0;
    for (unsigned channel = 0; channel < 16u; channel++) {
        const unsigned pin = CHIP_PIN((channel < 8u) ? 'A' : 'B', channel & 7u);
        const bool connected = function_of(pins, pin) == FUNCTION_ANALOG;
        pins->analog = (uint16_t)(pins->analog | ((connected ? 1u : 0u) << channel));
    }
    signals->pins_routed(pins->bus->chip);
    for (unsigned i = 0; i < CHOICES; i++) { /* an input without a pin is low */
        const unsigned pin = choices[i].pin;
        if (before[pin] != pins->function[pin]) {
            set_input(pins, (pin_function_t)before[pin], false);
        }
    }
    for (unsigned i = 0; i < CHOICES; i++) {
        const unsigned pin = choices[i].pin;
        set_input(pins, function_of(pins, pin), level_of(pins, pin));
    }
    signals->gate_pins_changed(pins->bus->chip);
    pins->bus->environment->deferrable_edges_changed(pins->bus->board);
}

bool pins_level(const pins_t *pins, unsigned pin)
{
    const gpio_port_t *port = &pins->port[pin >> 4];
    const unsigned bit = 1u << (pin & 15u);
    if ((port->reg[PER] & bit) == 0 && (port->reg[DDR] & bit) != 0) {
        return (port->reg[DR] & bit) != 0;
    }
    for (unsigned i = 0; i < PINS_GATES; i++) {
        if (pins->wiring.gate[i / 6u][i % 6u / 2u][i % 2u] == pin) {
            return pins->bus->signals->gate_level(pins->bus->chip, i / 6u, i % 6u / 2u, i % 2u);
        }
    }
    return level_of(pins, pin);
}

void pins_power_on(pins_t *pins, bus_t *bus, const chip_wiring_t *wiring)
{
    pins->bus = bus;
    pins->wiring = *wiring;
    for (unsigned i = 0; i < PINS_GATES; i++) {
        const unsigned pin = wiring->gate[i / 6u][i % 6u / 2u][i % 2u];
        if (pin < CHIP_PINS) {
            pins->gates[pin >> 4] = (uint16_t)(pins->gates[pin >> 4] | (1u << (pin & 15u)));
        }
    }
}

void pins_reset(void *peripheral)
{
    pins_t *pins = (pins_t *)peripheral;
    for (unsigned i = 0; i < GPIO_PORTS; i++) {
        pins->port[i] = (gpio_port_t){{0}};
    }
    pins->xb_in = 0;
}

/* ---- registers of the ports ------------------------------------------------------------------------------------------ */

static gpio_port_t *port_of(pins_t *pins, uint32_t address)
{
    const unsigned index = (address - GPIO_BASE) >> 4;
    bus_check_gate(pins->bus, address, 0, 6u - index);
    return &pins->port[index];
}

uint16_t gpio_read(void *peripheral, uint32_t address)
{
    pins_t *pins = (pins_t *)peripheral;
    const gpio_port_t *port = port_of(pins, address);
    const unsigned number = address & 0xFu;
    unsigned levels = 0;
    if (number > SRE) {
        bus_no_register(pins->bus, address);
    }
    if (number != RAWDATA) {
        return port->reg[number];
    }
    pins->bus->signals->timer_catch_up(pins->bus->chip);
    for (unsigned bit = 0; bit < 16u; bit++) {
        levels |= (pins_level(pins, ((address - GPIO_BASE) & ~0xFu) | bit) ? 1u : 0u) << bit;
    }
    return (uint16_t)levels;
}

void gpio_write(void *peripheral, uint32_t address, uint16_t value)
{
    pins_t *pins = (pins_t *)peripheral;
    bus_t *bus = pins->bus;
    gpio_port_t *port = port_of(pins, address);
    const unsigned number = address & 0xFu;
    if (number == IENR || number == IAR || number == IPOLR) {
        bus_allow(bus, address, value, 0, "interrupts of pins are not modelled");
    } else if (number == IPR || number == RAWDATA || number > SRE) {
        bus_no_register(bus, address);
    } else if (number != IESR) { /* which clears what is never set */
        const unsigned changed = port->reg[number] ^ value;
        port->reg[number] = value;
        if (number == PER) {
            pins_route(pins);
        } else if (number == DDR || (number == DR && (changed & pins->gates[(address - GPIO_BASE) >> 4]) != 0)) {
            bus->signals->gate_pins_changed(bus->chip);
        }
        if (number == DDR || number == DR) {
            bus->environment->outputs_changed(bus->board);
        }
    }
}
