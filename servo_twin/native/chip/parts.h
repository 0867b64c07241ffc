/* parts.h - what the peripherals of the chip offer to each other. */
#ifndef CHIP_PARTS_H
#define CHIP_PARTS_H

#include "chip/chip.h"

#if defined(__GNUC__)
#define CHIP_NORETURN __attribute__((noreturn))
#define CHIP_PRINTF(text, first) __attribute__((format(printf, text, first)))
#define NOINLINE __attribute__((noinline)) /* what is rare stays out of its callers: their short way needs no frame */
#else
#define CHIP_NORETURN
#define CHIP_PRINTF(text, first)
#define NOINLINE
#endif

/* ---- errors (chip.c) ------------------------------------------------------------------------------------------------ */

/* End the run: what happened. The clock is added. */
CHIP_NORETURN void chip_fail(chip_t *chip, const char *format, ...) CHIP_PRINTF(2, 3);

/* End the run: this register does not exist here, or this value of it is not modelled. */
CHIP_NORETURN void chip_no_register(chip_t *chip, uint32_t address);
CHIP_NORETURN void chip_no_value(chip_t *chip, uint32_t address, uint16_t value, const char *why);

/* Refuse bits of a value. */
static inline void chip_only(chip_t *chip, uint32_t address, uint16_t value, uint16_t allowed, const char *why)
{
    if ((value & ~allowed) != 0) {
        chip_no_value(chip, address, value, why);
    }
}

/* Name of a register for people, "PWMA SM1 VAL3"; always terminated. */
void chip_register_name(uint32_t address, char *name, size_t size);

/* The lowest bit of a word that has one. */
static inline unsigned chip_lowest_bit(uint64_t word)
{
#if defined(__GNUC__)
    return (unsigned)__builtin_ctzll(word);
#else
    unsigned bit = 0;
    for (unsigned half = 32; half > 0; half /= 2u) {
        if ((word & ((UINT64_C(1) << half) - 1u)) == 0) {
            word >>= half;
            bit += half;
        }
    }
    return bit;
#endif
}

CHIP_NORETURN void chip_reset(chip_t *chip, reset_cause_t cause);

static inline void chip_note(chip_t *chip, trace_kind_t kind, uint32_t a, uint32_t b)
{
    if (chip->trace.left > 0u) {
        chip->trace.left--;
        chip->trace.entry[chip->trace.size++] = (trace_entry_t){chip->now, (uint16_t)kind, (uint16_t)a, b};
    }
}

static inline uint64_t chip_sooner(uint64_t a, uint64_t b) { return (a < b) ? a : b; }

/* When the next event of a source is; who keeps the first of several has to look again. */
static inline void chip_set_turn(chip_t *chip, unsigned source, uint64_t clock)
{
    chip->turn[source] = CHIP_TURN(clock, source);
}

/* At the present clock, or missed. */
static inline bool chip_is_due(const chip_t *chip, unsigned source)
{
    return CHIP_TURN_CLOCK(chip->turn[source]) <= chip->now;
}

/* After a change of a turn in this group; that of a PWM module has its number. */
static inline void chip_find_first(chip_t *chip, unsigned group)
{
    const uint64_t *turn = &chip->turn[CHIP_GROUP * group];
    chip->first[group] = chip_sooner(chip_sooner(turn[0], turn[1]), chip_sooner(turn[2], turn[3]));
}

/* A turn, and the first of its group with it. It is not read again for that, which would take longer than all the rest. */
static inline void chip_move_turn(chip_t *chip, unsigned source, uint64_t clock)
{
    static const uint64_t itself[CHIP_GROUP][CHIP_GROUP] = {
        {UINT64_MAX, 0, 0, 0}, {0, UINT64_MAX, 0, 0}, {0, 0, UINT64_MAX, 0}, {0, 0, 0, UINT64_MAX}};
    const unsigned group = source / CHIP_GROUP;
    const uint64_t *mask = itself[source % CHIP_GROUP];
    const uint64_t *turn = &chip->turn[CHIP_GROUP * group];
    const uint64_t others = chip_sooner(chip_sooner(turn[0] | mask[0], turn[1] | mask[1]),
                                        chip_sooner(turn[2] | mask[2], turn[3] | mask[3]));
    chip_set_turn(chip, source, clock);
    chip->first[group] = chip_sooner(CHIP_TURN(clock, source), others);
}

/* When the next event of a source behind the PWMs is. */
static inline void chip_schedule(chip_t *chip, unsigned source, uint64_t clock)
{
    chip_move_turn(chip, source, clock);
    chip->quiet_turn = chip_sooner(chip->first[PWM_MODULES], chip->first[PWM_MODULES + 1]);
}

/* The turn of the event that is next of all. */
static inline uint64_t chip_next_turn(const chip_t *chip)
{
    return chip_sooner(chip->quiet_turn, chip_sooner(chip->first[0], chip->first[1]));
}

/* Software that has waited for something may do so again. */
static inline void chip_pass_time(chip_t *chip, uint64_t clock)
{
    chip->now = clock;
    chip->core.polls = 0;
}

/* Bring the world along to the present clock, before something acts on it or looks at it. */
static inline void sync_plant(chip_t *chip)
{
    if (chip->world_clock < chip->now) {
        chip->world_clock = chip->now;
        world_advance(chip->world, chip->now);
    }
}

/* ---- registers ------------------------------------------------------------------------------------------------------ */

uint16_t pwm_read(chip_t *chip, uint32_t address);
void pwm_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t adc_read(chip_t *chip, uint32_t address);
void adc_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t qtmr_read(chip_t *chip, uint32_t address);
void qtmr_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t xbar_read(chip_t *chip, uint32_t address);
void xbar_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t sci_read(chip_t *chip, uint32_t address);
void sci_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t ftfl_read(chip_t *chip, uint32_t address);
void ftfl_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t ftfl_data_read(chip_t *chip, uint32_t address);
uint16_t intc_read(chip_t *chip, uint32_t address);
void intc_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t gpio_read(chip_t *chip, uint32_t address);
void gpio_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t occs_read(chip_t *chip, uint32_t address);
void occs_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t sim_read(chip_t *chip, uint32_t address);
void sim_write(chip_t *chip, uint32_t address, uint16_t value);
uint16_t cop_read(chip_t *chip, uint32_t address);
void cop_write(chip_t *chip, uint32_t address, uint16_t value);

/* ---- reset state ---------------------------------------------------------------------------------------------------- */

void pwm_reset(chip_t *chip);
void adc_reset(chip_t *chip);
void qtmr_reset(chip_t *chip);
void xbar_reset(chip_t *chip);
void sci_reset(chip_t *chip);
void ftfl_reset(chip_t *chip);
void core_reset(chip_t *chip);
void system_reset(chip_t *chip, reset_cause_t cause);

/* ---- events at the present clock -------------------------------------------------------------------------------------- */

void pwm_event(chip_t *chip, unsigned n);
void pwm_fault_event(chip_t *chip);
NOINLINE void adc_event(chip_t *chip, unsigned converter);
void qtmr_event(chip_t *chip, unsigned module);
void sci_event(chip_t *chip);
void cop_event(chip_t *chip);

/* ---- the core (core.c) ------------------------------------------------------------------------------------------------ */

/* One event up to `until`, a pause of chip_run, or that clock itself; false then. */
bool chip_step(chip_t *chip, uint64_t until);

void core_boot(chip_t *chip);
CHIP_NORETURN void core_live(chip_t *chip); /* handlers and background, whenever they are due */
void core_busy(chip_t *chip, uint64_t clocks); /* the software works */
void core_settle(chip_t *chip); /* what it has spent up to here takes its time */
void core_accessed(chip_t *chip); /* after that of a register: the next event may have come nearer */
void core_run(chip_t *chip); /* charges are for this chip */
void core_pause(void); /* and for none */
bool core_runs(const chip_t *chip);

/* ---- signals --------------------------------------------------------------------------------------------------------- */

/* A peripheral asks for its interrupt, or no longer does. */
static inline void intc_request(chip_t *chip, unsigned vector, bool on)
{
    const uint64_t bit = UINT64_C(1) << (vector & 63u);
    uint64_t *word = &chip->core.request[vector >> 6];
    const uint64_t value = on ? (*word | bit) : (*word & ~bit);
    if (value != *word) {
        *word = value;
        chip->core.changed = true;
    }
}

/* The background has something to do, as soon as no handler runs. */
static inline void core_wake(chip_t *chip)
{
    chip->core.background_due = true;
    chip->core.changed = true;
}

/* An input of crossbar A, of B (-1: none). */
void xbar_signal(chip_t *chip, int a_input, int b_input, xbar_edge_t edge);

void pwm_ext_sync(chip_t *chip, unsigned module, unsigned submodule); /* at the present clock; latency is added */
void pwm_fault_input(chip_t *chip, unsigned module, unsigned input, bool level);
void pwm_pins_changed(chip_t *chip); /* routing of the gate pins */
void pwm_gates_changed(chip_t *chip); /* clock gates of the SIM */
void adc_sync(chip_t *chip, unsigned converter);
void qtmr_gates_changed(chip_t *chip);
void qtmr_input(chip_t *chip, unsigned module, unsigned input, bool level, uint64_t clock); /* past, if it is patient */
void qtmr_pulse(chip_t *chip, unsigned module, unsigned input);
void qtmr_catch_up(chip_t *chip); /* with all edges up to the present clock, before they are read */

/* ---- pins and gates --------------------------------------------------------------------------------------------------- */

/* Functions that a pin can be given to. */
typedef enum {
    FUNCTION_GPIO,
    FUNCTION_OTHER, /* one that is not modelled */
    FUNCTION_ANALOG,
    FUNCTION_PWM_A0A, /* + 8 module + 2 submodule + side */
    FUNCTION_FAULT_A0 = FUNCTION_PWM_A0A + 16, /* + 8 module + input */
    FUNCTION_TIMER_A0 = FUNCTION_FAULT_A0 + 16, /* + 4 module + channel */
    FUNCTION_TXD0 = FUNCTION_TIMER_A0 + 8,
    FUNCTION_RXD0 = FUNCTION_TXD0 + SCI_MODULES,
    FUNCTION_XB_IN2 = FUNCTION_RXD0 + SCI_MODULES, /* XB_IN2 .. XB_IN11 */
    FUNCTION_COUNT = FUNCTION_XB_IN2 + 10
} pin_function_t;

pin_function_t pins_function(const chip_t *chip, unsigned pin);

void pins_reroute(chip_t *chip); /* a function select, a port's PER or SIM_IPS0 has changed */

static inline bool sim_gate_open(const chip_t *chip, unsigned index, unsigned bit)
{
    return ((chip->sim.pce[index] >> bit) & 1u) != 0;
}

/* End the run: access behind a closed gate. */
CHIP_NORETURN void sim_gate_closed(chip_t *chip, uint32_t address, unsigned index, unsigned bit);

static inline void sim_gate(chip_t *chip, uint32_t address, unsigned index, unsigned bit)
{
    if (!sim_gate_open(chip, index, bit)) {
        sim_gate_closed(chip, address, index, bit);
    }
}

/* Something starts that needs the full bus clock. */
void occs_need_bus_clock(chip_t *chip, const char *what);

#endif
