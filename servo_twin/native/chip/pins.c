#include "chip/pins.h"

#include "chip/parts.h"

#define BASE 0xE200u

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

static pin_function_t chosen(const chip_t *chip, const choice_t *choice)
{
    if (((chip->pins.port[choice->pin >> 4].peripheral >> (choice->pin & 15u)) & 1u) == 0) {
        return FUNCTION_GPIO;
    }
    const unsigned code = ((unsigned)chip->pins.select[choice->select] >> choice->shift) & ((1u << choice->width) - 1u);
    const pin_function_t function = (pin_function_t)choice->function[code];
    return (function == FUNCTION_GPIO) ? FUNCTION_OTHER : function; /* an entry left out: a reserved code */
}

static pin_function_t find(const chip_t *chip, unsigned pin)
{
    for (unsigned i = 0; i < CHOICES; i++) {
        if (choices[i].pin == pin) {
            return chosen(chip, &choices[i]);
        }
    }
    const bool peripheral = ((chip->pins.port[pin >> 4].peripheral >> (pin & 15u)) & 1u) != 0;
    const bool analog = pin < CHIP_PIN('C', 0) && (pin & 15u) < 8u;
    return !peripheral ? FUNCTION_GPIO : analog ? FUNCTION_ANALOG : FUNCTION_OTHER;
}

pin_function_t pins_function(const chip_t *chip, unsigned pin)
{
    return (pin < CHIP_PINS) ? (pin_function_t)chip->pins.function[pin] : FUNCTION_OTHER;
}

static bool level_of(const chip_t *chip, unsigned pin) { return ((chip->pins.in[pin >> 4] >> (pin & 15u)) & 1u) != 0; }

/* ---- signals from pins ----------------------------------------------------------------------------------------------- */

/* Input of a timer or of the fault logic comes from its pin, unless SIM_IPS0 gives it to the crossbar. */
static bool from_crossbar(const chip_t *chip, unsigned bit) { return ((chip->sim.ips0 >> bit) & 1u) != 0; }

/* The input of a timer that a function is, 4 module + channel; or NO_TIMER. */
#define TIMER_INPUTS (QTMR_MODULES * QTMR_CHANNELS)
#define NO_TIMER TIMER_INPUTS

static inline unsigned timer_input(const chip_t *chip, pin_function_t function)
{
    const unsigned i = (unsigned)function - FUNCTION_TIMER_A0;
    return (i < TIMER_INPUTS && !from_crossbar(chip, 8u + i)) ? i : NO_TIMER;
}

static void put(chip_t *chip, pin_function_t function, bool level)
{
    const unsigned timer = timer_input(chip, function);
    if (timer != NO_TIMER) {
        qtmr_input(chip, timer / QTMR_CHANNELS, timer % QTMR_CHANNELS, level, chip->now);
    } else if (function >= FUNCTION_FAULT_A0 && function < FUNCTION_TIMER_A0) {
        const unsigned i = (unsigned)(function - FUNCTION_FAULT_A0);
        if ((i & 7u) < PWM_FAULTS && !from_crossbar(chip, (i / 8u) * 4u + (i & 7u))) {
            pwm_fault_input(chip, i / 8u, i & 7u, level);
        }
    } else if (function >= FUNCTION_XB_IN2 && function < FUNCTION_COUNT) {
        const unsigned n = (unsigned)(function - FUNCTION_XB_IN2) + 2u;
        const int b = (n == 2u) ? 14 : (n == 3u) ? 15 : (n == 10u) ? 20 : (n == 11u) ? 21 : -1;
        if (((chip->xbar.level >> n) & 1u) != (level ? 1u : 0u)) {
            xbar_signal(chip, (int)n, b, level ? XBAR_RISE : XBAR_FALL);
        }
    }
}

static inline void set_level(chip_t *chip, unsigned pin, bool level)
{
    uint16_t *in = &chip->pins.in[pin >> 4];
    const unsigned bit = 1u << (pin & 15u);
    *in = (uint16_t)(level ? (*in | bit) : (*in & ~bit));
}

void chip_pin(chip_t *chip, unsigned pin, bool level)
{
    set_level(chip, pin, level);
    put(chip, pins_function(chip, pin), level);
}

unsigned chip_deferrable_edges(const chip_t *chip, unsigned pin)
{
    const unsigned i = timer_input(chip, pins_function(chip, pin));
    return (i != NO_TIMER) ? chip->timer[i / QTMR_CHANNELS].deferrable_edges : 0u;
}

void chip_pin_late(chip_t *chip, unsigned pin, bool level, uint64_t clock)
{
    const unsigned i = timer_input(chip, pins_function(chip, pin));
    if (i == NO_TIMER) {
        chip_pin(chip, pin, level);
        return;
    }
    set_level(chip, pin, level);
    qtmr_input(chip, i / QTMR_CHANNELS, i % QTMR_CHANNELS, level, clock);
}

void pins_reroute(chip_t *chip)
{
    uint8_t before[CHIP_PINS];
    qtmr_catch_up(chip);
    for (unsigned pin = 0; pin < CHIP_PINS; pin++) {
        before[pin] = chip->pins.function[pin];
        chip->pins.function[pin] = (uint8_t)find(chip, pin);
    }
    chip->pins.analog = 0;
    for (unsigned channel = 0; channel < 16u; channel++) {
        const unsigned pin = CHIP_PIN((channel < 8u) ? 'A' : 'B', channel & 7u);
        const bool connected = pins_function(chip, pin) == FUNCTION_ANALOG;
        chip->pins.analog = (uint16_t)(chip->pins.analog | ((connected ? 1u : 0u) << channel));
    }
    for (unsigned i = 0; i < CHOICES; i++) { /* who has lost its pin hears silence */
        const unsigned pin = choices[i].pin;
        if (before[pin] != chip->pins.function[pin]) {
            put(chip, (pin_function_t)before[pin], false);
        }
    }
    for (unsigned i = 0; i < CHOICES; i++) {
        const unsigned pin = choices[i].pin;
        put(chip, pins_function(chip, pin), level_of(chip, pin));
    }
    for (unsigned i = 0; i < GPIO_PORTS; i++) {
        chip->pins.gates[i] = 0;
    }
    for (unsigned i = 0; i < 12u; i++) {
        const unsigned pin = chip->config.wiring.gate[i / 6u][i % 6u / 2u][i % 2u];
        if (pin < CHIP_PINS) {
            chip->pins.gates[pin >> 4] = (uint16_t)(chip->pins.gates[pin >> 4] | (1u << (pin & 15u)));
        }
    }
    pwm_pins_changed(chip);
    world_deferrable_edges(chip->world);
}

bool chip_pin_level(const chip_t *chip, unsigned pin)
{
    const gpio_port_t *port = &chip->pins.port[pin >> 4];
    const unsigned bit = 1u << (pin & 15u);
    if ((port->peripheral & bit) == 0 && (port->direction & bit) != 0) {
        return (port->data & bit) != 0;
    }
    for (unsigned m = 0; m < 2u; m++) {
        for (unsigned i = 0; i < 6u; i++) {
            if (chip->config.wiring.gate[m][i / 2u][i % 2u] == pin) {
                return ((chip->pwm[m].sub[i / 2u].levels >> (i % 2u)) & 1u) != 0;
            }
        }
    }
    return level_of(chip, pin);
}

/* ---- registers of the ports ------------------------------------------------------------------------------------------ */

static gpio_port_t *port_of(chip_t *chip, uint32_t address)
{
    const unsigned index = (address - BASE) >> 4;
    sim_gate(chip, address, 0, 6u - index);
    return &chip->pins.port[index];
}

uint16_t gpio_read(chip_t *chip, uint32_t address)
{
    const gpio_port_t *port = port_of(chip, address);
    const unsigned index = (address - BASE) >> 4;
    switch (address & 0xFu) {
    case PUR:
        return port->pull;
    case DR:
        return port->data;
    case DDR:
        return port->direction;
    case PER:
        return port->peripheral;
    case IENR:
    case IAR:
    case IPOLR:
    case IPR:
    case IESR:
        return 0;
    case PPMODE:
        return port->drive_mode;
    case RAWDATA: {
        unsigned levels = 0;
        qtmr_catch_up(chip);
        for (unsigned bit = 0; bit < 16u; bit++) {
            levels |= (chip_pin_level(chip, (index << 4) | bit) ? 1u : 0u) << bit;
        }
        return (uint16_t)levels;
    }
    case DRIVE:
        return port->drive;
    case PUS:
        return port->pull_up;
    case SRE:
        return port->slew;
    default:
        chip_no_register(chip, address);
    }
}

void gpio_write(chip_t *chip, uint32_t address, uint16_t value)
{
    gpio_port_t *port = port_of(chip, address);
    const unsigned index = (address - BASE) >> 4;
    unsigned changed;
    switch (address & 0xFu) {
    case PUR:
        port->pull = value;
        break;
    case DR:
        changed = port->data ^ value;
        port->data = value;
        if ((changed & chip->pins.gates[index]) != 0) {
            pwm_pins_changed(chip);
        }
        world_outputs(chip->world);
        break;
    case DDR:
        port->direction = value;
        pwm_pins_changed(chip);
        world_outputs(chip->world);
        break;
    case PER:
        port->peripheral = value;
        pins_reroute(chip);
        break;
    case IENR:
    case IAR:
    case IPOLR:
        chip_only(chip, address, value, 0, "interrupts of pins are not modelled");
        break;
    case IESR:
        break; /* clears what is never set */
    case PPMODE:
        port->drive_mode = value;
        break;
    case DRIVE:
        port->drive = value;
        break;
    case PUS:
        port->pull_up = value;
        break;
    case SRE:
        port->slew = value;
        break;
    default:
        chip_no_register(chip, address);
    }
}
