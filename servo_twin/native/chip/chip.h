/* chip.h - the MC56F84789 as far as a servo uses it: registers, peripherals, interrupts, time.
 *
 * Time is counted in clocks of the 100 MHz bus (10 ns) since power-on. The chip is event driven: each source of events
 * says when its next one is, nothing is ticked. What is not modelled is an error that ends the run and names the
 * register; after an error the chip stands still.
 *
 * The software tells by core_time.h how far it has got: an access to a register happens at its clock, and an interrupt of a
 * higher level comes between two statements. Software without charges takes no time but what world_interrupt returns. Events
 * and software run on a stack of their own, so that chip_run can end in the middle of a handler. While the software boots
 * each access takes a few clocks, so that it can wait for flags.
 */
#ifndef CHIP_CHIP_H
#define CHIP_CHIP_H

#include <setjmp.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <ucontext.h>

#include "chip/adc.h"
#include "chip/core.h"
#include "chip/ftfl.h"
#include "chip/pins.h"
#include "chip/pwm.h"
#include "chip/qtmr.h"
#include "chip/sci.h"
#include "chip/system.h"
#include "chip/trace.h"
#include "chip/world.h"
#include "chip/xbar.h"

#define CHIP_BUS_HZ 100000000
#define CHIP_ERROR_SIZE 200

/* Sources of events; at one clock they are served in this order. */
typedef enum {
    SOURCE_PWM,                                               /* one per submodule */
    SOURCE_FAULT = SOURCE_PWM + PWM_MODULES * PWM_SUBMODULES, /* filters of the fault inputs */
    SOURCE_TIMER,                                             /* one per module */
    SOURCE_ADC = SOURCE_TIMER + QTMR_MODULES,                 /* one per converter */
    SOURCE_SERIAL = SOURCE_ADC + ADC_CONVERTERS,
    SOURCE_COP,
    CHIP_SOURCES
} chip_source_t;

/* When an event of a source is due, in one number: the smallest of several is the one to be served first. Clocks have 60
 * bits then, more than three centuries; CHIP_NEVER stays behind all of them. */
#define CHIP_SOURCES_MOST 16u
typedef char chip_sources_fit_t[(CHIP_SOURCES <= CHIP_SOURCES_MOST) ? 1 : -1];
#define CHIP_TURN(clock, source) ((uint64_t)(clock) * CHIP_SOURCES_MOST + (source))
#define CHIP_TURN_CLOCK(turn) ((turn) / CHIP_SOURCES_MOST)
#define CHIP_TURN_SOURCE(turn) ((unsigned)((turn) % CHIP_SOURCES_MOST))
#define CHIP_NO_TURN CHIP_TURN(CHIP_NEVER, 0) /* or one above */

/* Of each so many sources the first event is kept: of the submodules of a PWM module, then of the others. */
#define CHIP_GROUP PWM_SUBMODULES
#define CHIP_GROUPS (CHIP_SOURCES_MOST / CHIP_GROUP)

typedef struct {
    chip_wiring_t wiring;
    double baud;             /* of the host */
    unsigned crossbar_clocks; /* from a trigger to the input that it is led to */
    core_speed_t core;
    const uint8_t *flash; /* image of the data flash; NULL: erased */
    uint64_t seed;        /* of what a command leaves that power has cut off */
} chip_config_t;

typedef struct chip {
    uint64_t now;
    uint64_t turn[CHIP_SOURCES_MOST]; /* of the next event of each source */
    uint64_t first[CHIP_GROUPS];      /* the first of each group */
    uint64_t quiet_turn;              /* and of all behind the PWMs, which have few events */
    uint64_t world_clock;    /* the world stands here */
    uint64_t caught_up;      /* no edge of a pin is kept back from before */
    void *world;                 /* of the functions of world.h */
    chip_config_t config;
    core_t core;
    pwm_t pwm[PWM_MODULES];
    pwm_submodule_t *submodule[PWM_MODULES * PWM_SUBMODULES]; /* of both, by their sources of events */
    adc_t adc;
    qtmr_t timer[QTMR_MODULES];
    xbar_t xbar;
    sci_t sci[SCI_MODULES];
    sci_line_t line;
    pins_t pins;
    occs_t occs;
    sim_t sim;
    cop_t cop;
    ftfl_t ftfl;
    trace_t trace;
    bool stop;               /* end chip_run before the next event */
    bool must_boot;
    bool alive;              /* `inside` is suspended there */
    uint64_t limit;          /* of this chip_run */
    bool failed;
    char error[CHIP_ERROR_SIZE];
    jmp_buf escape;          /* out of the software that made an error, or that a reset ends */
    ucontext_t inside, outside;
    _Alignas(16) uint8_t stack[CORE_STACK];
} chip_t;

/* Power on. The software boots in the first chip_run. */
void chip_init(chip_t *chip, const chip_config_t *config, void *world);

/* Everything up to and including `until`; booting may take longer. Returns false if an error has ended the run. */
bool chip_run(chip_t *chip, uint64_t until);

/* ---- the software's side ------------------------------------------------------------------------------------------- */

uint16_t chip_read(chip_t *chip, uint32_t address);
void chip_write(chip_t *chip, uint32_t address, uint16_t value);

/* The core's mask of all interrupts; masked after reset. */
void chip_interrupts(chip_t *chip, bool on);

/* ---- the board's side ---------------------------------------------------------------------------------------------- */

/* A digital input changes at the present clock. */
void chip_pin(chip_t *chip, unsigned pin, bool level);

/* So many edges at a pin change nothing but counts. They may be kept back then, until world_late asks for them; those of
 * all pins with the same timer module count together. */
unsigned chip_deferrable_edges(const chip_t *chip, unsigned pin);

/* One of these, at the clock at which it was; in order for each module. */
void chip_pin_late(chip_t *chip, unsigned pin, bool level, uint64_t clock);

/* Registers from outside of chip_run, as with a debugger: the value, or 0; -1 after an error. */
int32_t chip_peek(chip_t *chip, uint32_t address);
int chip_poke(chip_t *chip, uint32_t address, uint16_t value);

/* Level of a pin, driven from inside or outside. */
bool chip_pin_level(const chip_t *chip, unsigned pin);

/* The host's end of the serial line. */
size_t chip_line_write(chip_t *chip, const uint8_t *data, size_t size);
size_t chip_line_read(chip_t *chip, uint8_t *data, size_t room);
uint64_t chip_line_next(const chip_t *chip); /* when the next byte moves */

#endif
