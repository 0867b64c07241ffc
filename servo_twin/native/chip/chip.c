#include "chip/chip.h"

#include <string.h>

#define POLLS_MAX 20000u /* reads at one clock: the software polls a flag that cannot change */

/* ---- peripherals ---------------------------------------------------------------------------------------------------- */

typedef struct {
    uint32_t base, end; /* addresses of the registers, the end excluded */
    size_t offset; /* of the peripheral in chip_t */
    uint16_t (*read)(void *peripheral, uint32_t address);
    void (*write)(void *peripheral, uint32_t address, uint16_t value);
    void (*reset)(void *peripheral); /* NULL: another entry resets it */
} peripheral_t;

#define AT(member) offsetof(chip_t, member)

/* The first one is tried for addresses outside of the pages. */
static const peripheral_t peripherals[] = {
    {FTFL_DATA_BASE, FTFL_DATA_END, AT(ftfl), ftfl_data_read, ftfl_data_write, NULL},
    {SCI_BASE, SCI_END, AT(sci), sci_read, sci_write, sci_reset},
    {QTMR_BASE, QTMR_END, AT(qtmr), qtmr_read, qtmr_write, qtmr_reset},
    {GPIO_BASE, GPIO_END, AT(pins), gpio_read, gpio_write, pins_reset},
    {OCCS_BASE, OCCS_END, AT(occs), occs_read, occs_write, occs_reset},
    {INTC_BASE, INTC_END, AT(intc), intc_read, intc_write, intc_reset},
    {COP_BASE, COP_END, AT(cop), cop_read, cop_write, cop_reset},
    {XBAR_BASE, XBAR_END, AT(xbar), xbar_read, xbar_write, xbar_reset},
    {FTFL_BASE, FTFL_END, AT(ftfl), ftfl_read, ftfl_write, ftfl_reset},
    {SIM_BASE, SIM_END, AT(sim), sim_read, sim_write, sim_reset},
    {ADC_BASE, ADC_END, AT(adc), adc_read, adc_write, adc_reset},
    {PWM_BASE, PWM_END, AT(pwm), pwm_read, pwm_write, pwm_reset},
};

#define PERIPHERALS (sizeof peripherals / sizeof peripherals[0])

static const struct {
    unsigned source, count; /* first of the sources, and how many there are */
    size_t offset;
    void (*handle)(void *peripheral, unsigned source);
} handlers[] = {
    {SOURCE_PWM, PWM_MODULES * PWM_SUBMODULES, AT(pwm), pwm_event},
    {SOURCE_FAULT, 1, AT(pwm), pwm_fault_event},
    {SOURCE_TIMER, QTMR_MODULES, AT(qtmr), qtmr_event},
    {SOURCE_ADC, ADC_CONVERTERS, AT(adc), adc_event},
    {SOURCE_SERIAL, 1, AT(sci), sci_event},
    {SOURCE_COP, 1, AT(cop), cop_event},
};

#define PAGE_BASE 0xE000u
#define PAGE_SIZE 16u /* no page has registers of two peripherals */

static inline void *at(chip_t *chip, size_t offset) { return (uint8_t *)chip + offset; }

static inline const peripheral_t *find_peripheral(chip_t *chip, uint32_t address)
{
    const uint32_t page = (address - PAGE_BASE) / PAGE_SIZE;
    const peripheral_t *found = &peripherals[(page < CHIP_PAGES) ? chip->peripheral_of[page] : 0u];
    if (address < found->base || address >= found->end) {
        bus_no_register(&chip->core.bus, address);
    }
    return found;
}

static void connect_peripherals(chip_t *chip)
{
    for (unsigned i = 1; i < PERIPHERALS; i++) {
        for (uint32_t address = peripherals[i].base; address < peripherals[i].end; address++) {
            chip->peripheral_of[(address - PAGE_BASE) / PAGE_SIZE] = (uint8_t)i;
        }
    }
    for (unsigned i = 0; i < sizeof handlers / sizeof handlers[0]; i++) {
        for (unsigned n = 0; n < handlers[i].count; n++) {
            chip->core.bus.events.handler[handlers[i].source + n] =
                (event_handler_t){handlers[i].handle, at(chip, handlers[i].offset)};
        }
    }
}

/* ---- signals between peripherals ------------------------------------------------------------------------------------ */

static chip_t *chip_of(void *chip) { return (chip_t *)chip; }

static void signal_crossbar(void *chip, int a_input, int b_input, xbar_edge_t edge)
{
    xbar_signal(&chip_of(chip)->xbar, a_input, b_input, edge);
}

static void signal_adc_sync(void *chip, unsigned converter) { adc_sync(&chip_of(chip)->adc, converter); }

static void signal_pwm_ext_sync(void *chip, unsigned module, unsigned submodule)
{
    pwm_ext_sync(&chip_of(chip)->pwm, module, submodule);
}

static void signal_pwm_fault(void *chip, unsigned module, unsigned input, bool level)
{
    pwm_fault_input(&chip_of(chip)->pwm, module, input, level);
}

static void signal_timer_input(void *chip, unsigned module, unsigned input, bool level)
{
    qtmr_input(&chip_of(chip)->qtmr, module, input, level, chip_of(chip)->core.bus.now);
}

static void signal_timer_pulse(void *chip, unsigned module, unsigned input)
{
    qtmr_pulse(&chip_of(chip)->qtmr, module, input);
}

static void signal_timer_catch_up(void *chip) { qtmr_catch_up(&chip_of(chip)->qtmr); }

static void signal_clock_gates_changed(void *chip)
{
    pwm_gates_changed(&chip_of(chip)->pwm);
    qtmr_gates_changed(&chip_of(chip)->qtmr);
}

static void signal_route_pins(void *chip) { pins_route(&chip_of(chip)->pins); }

static void connect_gates(chip_t *chip)
{
    for (unsigned i = 0; i < PINS_GATES; i++) {
        const unsigned module = i / 6u, submodule = i % 6u / 2u, side = i % 2u;
        chip->pwm.module[module].sub[submodule].pin[side] = (uint8_t)pins_gate(&chip->pins, module, submodule, side);
    }
}

static void signal_pins_routed(void *self)
{
    chip_t *chip = chip_of(self);
    chip->adc.connected = chip->pins.analog;
    chip->sci.sender = pins_sender(&chip->pins);
    chip->sci.receiver = pins_receiver(&chip->pins);
    connect_gates(chip);
}

static void signal_gate_pins_changed(void *chip)
{
    connect_gates(chip_of(chip));
    pwm_pins_changed(&chip_of(chip)->pwm);
}

static bool signal_gate_level(void *chip, unsigned module, unsigned submodule, unsigned side)
{
    return ((chip_of(chip)->pwm.module[module].sub[submodule].levels >> side) & 1u) != 0;
}

static void signal_need_bus_clock(void *chip, const char *part) { occs_need_bus_clock(&chip_of(chip)->occs, part); }

CHIP_NORETURN static void signal_reset(void *self, reset_cause_t cause)
{
    chip_t *chip = chip_of(self);
    qtmr_catch_up(&chip->qtmr); /* the levels at the pins stay */
    events_reset(&chip->core.bus.events);
    core_reset(&chip->core);
    chip->sim.cause = cause;
    for (unsigned i = 0; i < PERIPHERALS; i++) {
        if (peripherals[i].reset != NULL) {
            peripherals[i].reset(at(chip, peripherals[i].offset));
        }
    }
    pins_route(&chip->pins);
    longjmp(chip->core.bus.escape, ESCAPE_RESET);
}

static const chip_signals_t signals = {
    .crossbar = signal_crossbar,
    .adc_sync = signal_adc_sync,
    .pwm_ext_sync = signal_pwm_ext_sync,
    .pwm_fault = signal_pwm_fault,
    .timer_input = signal_timer_input,
    .timer_pulse = signal_timer_pulse,
    .timer_catch_up = signal_timer_catch_up,
    .clock_gates_changed = signal_clock_gates_changed,
    .route_pins = signal_route_pins,
    .pins_routed = signal_pins_routed,
    .gate_pins_changed = signal_gate_pins_changed,
    .gate_level = signal_gate_level,
    .need_bus_clock = signal_need_bus_clock,
    .reset = signal_reset,
};

/* ---- access --------------------------------------------------------------------------------------------------------- */

CHIP_NORETURN NOINLINE static void fail_waiting(chip_t *chip, uint32_t address)
{
    char name[64];
    chip_register_name(address, name, sizeof name);
    bus_fail(&chip->core.bus, "the software waits for %s, which cannot change meanwhile", name);
}

uint16_t chip_read(chip_t *chip, uint32_t address)
{
    core_before_access(&chip->core);
    if (++chip->core.bus.polls > POLLS_MAX) {
        fail_waiting(chip, address);
    }
    const peripheral_t *peripheral = find_peripheral(chip, address);
    const uint16_t value = peripheral->read(at(chip, peripheral->offset), address);
    core_after_access(&chip->core);
    return value;
}

void chip_write(chip_t *chip, uint32_t address, uint16_t value)
{
    core_before_access(&chip->core);
    bus_note(&chip->core.bus, TRACE_WRITE, address, value);
    const peripheral_t *peripheral = find_peripheral(chip, address);
    peripheral->write(at(chip, peripheral->offset), address, value);
    core_after_access(&chip->core);
}

void chip_interrupts(chip_t *chip, bool on)
{
    chip->core.masked = !on;
    chip->core.bus.changed = true;
}

/* Errors of an access from outside end there. */
int32_t chip_peek(chip_t *chip, uint32_t address)
{
    jmp_buf within;
    volatile int32_t value = -1;
    memcpy(&within, &chip->core.bus.escape, sizeof within);
    if (!chip->core.bus.failed && setjmp(chip->core.bus.escape) == 0) {
        chip->core.bus.polls = 0;
        value = chip_read(chip, address);
    }
    memcpy(&chip->core.bus.escape, &within, sizeof within);
    return value;
}

int chip_poke(chip_t *chip, uint32_t address, uint16_t value)
{
    jmp_buf within;
    volatile int result = chip->core.bus.failed ? -1 : 0;
    memcpy(&within, &chip->core.bus.escape, sizeof within);
    switch (setjmp(chip->core.bus.escape)) {
    case 0:
        if (!chip->core.bus.failed && !chip->core.bus.must_boot) {
            chip_write(chip, address, value);
        }
        break;
    case ESCAPE_FAILURE:
        result = -1;
        break;
    default:
        break;
    }
    memcpy(&chip->core.bus.escape, &within, sizeof within);
    return result;
}

/* ---- pins ----------------------------------------------------------------------------------------------------------- */

void chip_pin(chip_t *chip, unsigned pin, bool level) { pins_set(&chip->pins, pin, level); }

bool chip_pin_level(const chip_t *chip, unsigned pin) { return pins_level(&chip->pins, pin); }

unsigned chip_deferrable_edges(const chip_t *chip, unsigned pin)
{
    const unsigned input = pins_timer_input(&chip->pins, pin);
    return (input < PINS_TIMER_INPUTS) ? chip->qtmr.module[input / QTMR_CHANNELS].deferrable_edges : 0u;
}

void chip_pin_late(chip_t *chip, unsigned pin, bool level, uint64_t clock)
{
    const unsigned input = pins_timer_input(&chip->pins, pin);
    if (input < PINS_TIMER_INPUTS) {
        pins_set_late(&chip->pins, pin, level);
        qtmr_input(&chip->qtmr, input / QTMR_CHANNELS, input % QTMR_CHANNELS, level, clock);
    } else {
        chip_pin(chip, pin, level);
    }
}

/* ---- life ----------------------------------------------------------------------------------------------------------- */

bool chip_run(chip_t *chip, uint64_t until)
{
    if (!chip->core.bus.failed) {
        core_run(&chip->core, until);
    }
    if (!chip->core.bus.failed) {
        qtmr_catch_up(&chip->qtmr);
    }
    return !chip->core.bus.failed;
}

void chip_init(chip_t *chip, const chip_config_t *config, const chip_environment_t *environment, void *board)
{
    memset(chip, 0, sizeof *chip);
    bus_t *bus = &chip->core.bus;
    bus->environment = environment;
    bus->board = board;
    bus->signals = &signals;
    bus->chip = chip;
    bus->crossbar_clocks = config->crossbar_clocks;
    chip->pwm.bus = chip->qtmr.bus = chip->adc.bus = chip->xbar.bus = chip->intc.bus = chip->occs.bus = bus;
    chip->sim.bus = chip->cop.bus = chip->ftfl.bus = bus;
    pins_power_on(&chip->pins, bus, &config->wiring);
    sci_init(&chip->sci, bus, config->baud);
    flash_init(&chip->ftfl.flash, config->flash, config->seed);
    core_init(&chip->core, &chip->intc, &config->core, chip->stack);
    connect_peripherals(chip);
    if (setjmp(bus->escape) == 0) {
        signal_reset(chip, RESET_POWER_ON);
    }
}
