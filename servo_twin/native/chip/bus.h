/* bus.h - what the peripherals share: clock, event queue, interrupt requests, clock gates, trace, errors, the environment, and
 * the signals between them as a table of functions, which chip.c fills in.
 *
 * A peripheral includes this header and its own one, none of another peripheral: so each of them runs alone in a test.
 */
#ifndef CHIP_BUS_H
#define CHIP_BUS_H

#include <setjmp.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "board_clock.h"
#include "chip/environment.h"
#include "chip/events.h"
#include "chip/trace.h"

#if defined(__GNUC__)
#define CHIP_NORETURN __attribute__((noreturn))
#define CHIP_PRINTF(text, first) __attribute__((format(printf, text, first)))
#define NOINLINE                                                                                                       \
    __attribute__((noinline)) /* rare paths, so that the frequent path of the caller needs no stack frame */
#else
#define CHIP_NORETURN
#define CHIP_PRINTF(text, first)
#define NOINLINE
#endif

#define CHIP_BUS_HZ (BOARD_CLOCK_MHZ * 1000000)
#define CHIP_ERROR_SIZE 200 /* bytes */

#define PWM_MODULES 2
#define PWM_SUBMODULES 4
#define PWM_FAULTS 4 /* inputs 0-3; 4-7 are not modelled */
#define QTMR_MODULES 2
#define QTMR_CHANNELS 4
#define ADC_CONVERTERS 2
#define SCI_MODULES 3

/* Sources of events; at one clock they are handled in this order. */
typedef enum {
    SOURCE_PWM, /* one per submodule */
    SOURCE_FAULT = SOURCE_PWM + PWM_MODULES * PWM_SUBMODULES, /* filters of the fault inputs */
    SOURCE_TIMER, /* one per module */
    SOURCE_ADC = SOURCE_TIMER + QTMR_MODULES, /* one per converter */
    SOURCE_SERIAL = SOURCE_ADC + ADC_CONVERTERS,
    SOURCE_COP,
    CHIP_SOURCES
} chip_source_t;

typedef char chip_sources_fit_t[(CHIP_SOURCES <= EVENT_SOURCES) ? 1 : -1];

/* Interrupt vectors. */
typedef enum {
    VECTOR_TMRB3 = 21,
    VECTOR_TMRB0 = 24,
    VECTOR_TMRA3 = 25,
    VECTOR_TMRA0 = 28,
    VECTOR_ADC_CC1 = 29,
    VECTOR_ADC_CC0 = 30,
    VECTOR_SCI2_RERR = 43,
    VECTOR_SCI1_RERR = 47,
    VECTOR_SCI0_RERR = 51, /* then RCV, TIDLE, TDRE */
    VECTOR_PWMB_FAULT = 63,
    VECTOR_PWMB_RERR = 64,
    VECTOR_PWMA_FAULT = 77,
    VECTOR_PWMA_RERR = 78,
    VECTOR_COP = 108,
} chip_vector_t;

/* Causes of a reset, as SIM_RSTAT has them. */
typedef enum { RESET_POWER_ON = 0x04, RESET_COP = 0x20, RESET_SOFTWARE = 0x40 } reset_cause_t;

/* What drives the pin of a gate: a level, or the PWM. */
typedef enum { GATE_LOW, GATE_HIGH, GATE_PWM } gate_pin_t;

/* What happens at an input of a crossbar; a pulse takes one clock. */
typedef enum { XBAR_FALL = 0, XBAR_RISE = 1, XBAR_PULSE = 2 } xbar_edge_t;

/* Signals from one peripheral to another, at the present clock. */
typedef struct {
    void (*crossbar)(void *chip, int a_input, int b_input, xbar_edge_t edge); /* inputs of A and B, -1: none */
    void (*adc_sync)(void *chip, unsigned converter);
    void (*pwm_ext_sync)(void *chip, unsigned module, unsigned submodule);
    void (*pwm_fault)(void *chip, unsigned module, unsigned input, bool level);
    void (*timer_input)(void *chip, unsigned module, unsigned input, bool level);
    void (*timer_pulse)(void *chip, unsigned module, unsigned input);
    void (*timer_catch_up)(void *chip); /* with the deferred edges, before a change of what they do */
    void (*clock_gates_changed)(void *chip); /* SIM_PCE */
    void (*route_pins)(void *chip); /* SIM_GPS or SIM_IPS0 have changed */
    void (*pins_routed)(void *chip); /* pins have other functions */
    void (*gate_pins_changed)(void *chip); /* so have those of the gates, or other levels */
    bool (*gate_level)(void *chip, unsigned module, unsigned submodule, unsigned side);
    void (*need_bus_clock)(void *chip, const char *part); /* an error, unless the bus runs at CHIP_BUS_HZ */
    void (*reset)(void *chip, reset_cause_t cause); /* does not return while software runs */
} chip_signals_t;

/* Registers of the SIM that act on other peripherals. */
typedef struct {
    uint16_t pce[4]; /* clock gates */
    uint16_t pcr; /* double clock rates */
    uint16_t gps[11]; /* function selects SIM_GPSAL .. SIM_GPSGH */
    uint16_t ips0; /* inputs that come from crossbar A instead of their pins */
} sim_control_t;

typedef struct {
    uint64_t now; /* clocks of 10 ns since power-on */
    events_t events;
    unsigned crossbar_clocks; /* delay of a trigger through a crossbar */
    uint64_t plant_clock; /* up to which the environment was advanced */
    const chip_environment_t *environment;
    void *board; /* first argument of the environment's functions */
    const chip_signals_t *signals;
    void *chip; /* first argument of the signals */
    uint64_t request[2]; /* bit per vector: its interrupt is requested */
    /* A request has changed, or the background has something to do. Not beside other flags: read together with them just after a
     * write, it would stall the processor until the write is complete. */
    bool changed;
    sim_control_t sim;
    bool background_due;
    uint64_t limit; /* last clock of this run */
    bool stop; /* end the run before the next event */
    bool must_boot; /* the software starts anew */
    uint32_t polls; /* reads of registers since time last moved */
    uint64_t access_clocks; /* per access to a register while the software boots */
    uint64_t stall; /* clocks by which the present access holds the core */
    uint64_t flash_stall; /* the same, if the core executes from the flash */
    trace_t trace;
    bool failed;
    char error[CHIP_ERROR_SIZE];
    jmp_buf escape; /* back from the software that caused an error or a reset */
} bus_t;

#define ESCAPE_FAILURE 1
#define ESCAPE_RESET 2

/* ---- errors (bus.c) ------------------------------------------------------------------------------------------------- */

/* End the run with this text; the time is appended. */
CHIP_NORETURN void bus_fail(bus_t *bus, const char *format, ...) CHIP_PRINTF(2, 3);

/* End the run: there is no such register, this value of it is not modelled, or its clock is gated off. */
CHIP_NORETURN void bus_no_register(bus_t *bus, uint32_t address);
CHIP_NORETURN void bus_no_value(bus_t *bus, uint32_t address, uint16_t value, const char *why);
CHIP_NORETURN void bus_gate_closed(bus_t *bus, uint32_t address, unsigned index, unsigned bit);

/* Refuse all bits of a value that are not allowed. */
static inline void bus_allow(bus_t *bus, uint32_t address, uint16_t value, uint16_t allowed, const char *why)
{
    if ((value & ~allowed) != 0) {
        bus_no_value(bus, address, value, why);
    }
}

/* Name of a register in messages, "PWMA SM1 VAL3" (names.c); always terminated. */
void chip_register_name(uint32_t address, char *name, size_t size);

/* ---- clock gates ---------------------------------------------------------------------------------------------------- */

static inline bool bus_gate_open(const bus_t *bus, unsigned index, unsigned bit)
{
    return ((bus->sim.pce[index] >> bit) & 1u) != 0;
}

static inline void bus_check_gate(bus_t *bus, uint32_t address, unsigned index, unsigned bit)
{
    if (!bus_gate_open(bus, index, bit)) {
        bus_gate_closed(bus, address, index, bit);
    }
}

/* ---- time ----------------------------------------------------------------------------------------------------------- */

static inline void bus_plan(bus_t *bus, unsigned source, uint64_t clock) { events_plan(&bus->events, source, clock); }

/* At the present clock, or missed. */
static inline bool bus_is_due(const bus_t *bus, unsigned source)
{
    return EVENT_CLOCK(bus->events.key[source]) <= bus->now;
}

/* Advance the plant to the present clock, before anything acts on it or reads it. */
static inline void bus_sync_plant(bus_t *bus)
{
    if (bus->plant_clock < bus->now) {
        bus->plant_clock = bus->now;
        bus->environment->advance(bus->board, bus->now);
    }
}

/* The present clock becomes this one. */
static inline void bus_pass_time(bus_t *bus, uint64_t clock)
{
    bus->now = clock;
    bus->polls = 0;
}

static inline uint64_t bus_next_of_plant(const bus_t *bus) { return bus->environment->next_event(bus->board); }

/* Handle the next event up to `until`; without one, go to that clock and return false. Then *next is the clock of the next event. */
static inline bool bus_step(bus_t *bus, uint64_t until, uint64_t *next)
{
    const uint64_t key = events_next(&bus->events);
    const uint64_t clock = EVENT_CLOCK(key);
    const uint64_t plant = bus_next_of_plant(bus);
    *next = events_earlier(plant, clock);
    if (*next > until) {
        if (until > bus->now) {
            bus_pass_time(bus, until);
        }
        return false;
    }
    if (plant <= clock) { /* the plant first: it may change which events are due */
        bus_pass_time(bus, plant);
        bus_sync_plant(bus);
        bus->environment->handle_events(bus->board);
    } else {
        bus_pass_time(bus, clock);
        events_handle(&bus->events, EVENT_SOURCE(key));
    }
    return true;
}

static inline void bus_note(bus_t *bus, trace_kind_t kind, uint32_t a, uint32_t b)
{
    if (bus->trace.remaining > 0u) {
        bus->trace.remaining--;
        bus->trace.entry[bus->trace.size++] = (trace_entry_t){bus->now, (uint16_t)kind, (uint16_t)a, b};
    }
}

/* ---- interrupts ----------------------------------------------------------------------------------------------------- */

/* Set or clear the request of a vector. */
static inline void bus_request(bus_t *bus, unsigned vector, bool on)
{
    const uint64_t bit = UINT64_C(1) << (vector & 63u);
    uint64_t *word = &bus->request[vector >> 6];
    const uint64_t value = on ? (*word | bit) : (*word & ~bit);
    if (value != *word) {
        *word = value;
        bus->changed = true;
    }
}

/* Run the background once, when no interrupt does. */
static inline void bus_wake_background(bus_t *bus)
{
    bus->background_due = true;
    bus->changed = true;
}

/* ---- bits ----------------------------------------------------------------------------------------------------------- */

/* Number of the lowest bit that is set; the word is not 0. */
static inline unsigned lowest_bit(uint64_t word)
{
#if defined(__GNUC__)
    return (unsigned)__builtin_ctzll(word);
#else
    unsigned bit = 0;
    while ((word & 1u) == 0) {
        word >>= 1;
        bit++;
    }
    return bit;
#endif
}

#endif
