/* chip.h - the MC56F84789 as far as a servo uses it: registers, peripherals, interrupts, time.
 *
 * Time is counted in clocks of the 100 MHz bus (10 ns) since power-on. The chip is event driven: each source of events
 * plans its next one, nothing is ticked. What is not modelled is an error that ends the run and names the register.
 */
#ifndef CHIP_CHIP_H
#define CHIP_CHIP_H

#include "chip/adc.h"
#include "chip/cop.h"
#include "chip/core.h"
#include "chip/ftfl.h"
#include "chip/occs.h"
#include "chip/pins.h"
#include "chip/pwm.h"
#include "chip/qtmr.h"
#include "chip/sci.h"
#include "chip/sim.h"
#include "chip/xbar.h"

#define CHIP_PAGES 128u /* pages of 16 words, from E000 on */

typedef struct {
    chip_wiring_t wiring;
    double baud;              /* baud rate of the host [bit/s] */
    unsigned crossbar_clocks; /* delay of a trigger through a crossbar */
    core_speed_t core;
    const uint8_t *flash; /* image of the data flash; NULL: erased */
    uint64_t seed;        /* seed of the flash contents after a power failure */
} chip_config_t;

typedef struct chip {
    core_t core;
    pwm_t pwm;
    qtmr_t qtmr;
    adc_t adc;
    xbar_t xbar;
    intc_t intc;
    pins_t pins;
    sci_t sci;
    occs_t occs;
    sim_t sim;
    cop_t cop;
    ftfl_t ftfl;
    uint8_t peripheral_of[CHIP_PAGES]; /* index into the table of peripherals */
    _Alignas(16) uint8_t stack[CORE_STACK];
} chip_t;

/* Power on. The software boots in the first chip_run. */
void chip_init(chip_t *chip, const chip_config_t *config, const chip_environment_t *environment, void *board);

/* All events and software up to and including `until`; booting may take longer. Returns false if an error has ended the run. */
bool chip_run(chip_t *chip, uint64_t until);

/* ---- for the software ----------------------------------------------------------------------------------------------- */

uint16_t chip_read(chip_t *chip, uint32_t address);
void chip_write(chip_t *chip, uint32_t address, uint16_t value);

/* The core's mask of all interrupts; masked after reset. */
void chip_interrupts(chip_t *chip, bool on);

/* ---- for the board -------------------------------------------------------------------------------------------------- */

/* A digital input changes at the present clock. */
void chip_pin(chip_t *chip, unsigned pin, bool level);

/* Number of coming edges at a pin of which nothing but a count follows: they may be deferred until the environment is asked
 * to report them. All pins of the same timer module share this number. */
unsigned chip_deferrable_edges(const chip_t *chip, unsigned pin);

/* A deferred edge, with the clock at which it was; in order for each module. */
void chip_pin_late(chip_t *chip, unsigned pin, bool level, uint64_t clock);

/* The next event of the plant may have come nearer, other than by a call of `advance` or `handle_events`. */
static inline void chip_plant_changed(chip_t *chip) { chip->core.horizon = 0; }

/* Access to registers from outside of chip_run, as with a debugger: the value, or 0; -1 after an error. */
int32_t chip_peek(chip_t *chip, uint32_t address);
int chip_poke(chip_t *chip, uint32_t address, uint16_t value);

/* Level of a pin, driven from inside or outside. */
bool chip_pin_level(const chip_t *chip, unsigned pin);

#endif
