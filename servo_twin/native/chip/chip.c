#include "chip/chip.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "chip/parts.h"

#define ESCAPE_FAILURE 1
#define ESCAPE_RESET 2
#define POLLS_MAX 20000u /* reads at one instant: software that waits for time, which stands still */

/* ---- errors ------------------------------------------------------------------------------------------------------- */

void chip_fail(chip_t *chip, const char *format, ...)
{
    if (!chip->failed) {
        char text[CHIP_ERROR_SIZE];
        va_list arguments;
        va_start(arguments, format);
        (void)vsnprintf(text, sizeof text, format, arguments);
        va_end(arguments);
        (void)snprintf(chip->error, sizeof chip->error, "%.150s (at %.2f us)", text, (double)chip->now * 0.01);
    }
    chip->failed = true;
    longjmp(chip->escape, ESCAPE_FAILURE);
}

void chip_no_register(chip_t *chip, uint32_t address)
{
    char name[64];
    chip_register_name(address, name, sizeof name);
    chip_fail(chip, "%s (%04lXh) is not modelled", name, (unsigned long)address);
}

void chip_no_value(chip_t *chip, uint32_t address, uint16_t value, const char *why)
{
    char name[64];
    chip_register_name(address, name, sizeof name);
    chip_fail(chip, "%s = %04Xh: %s", name, (unsigned)value, why);
}

void chip_reset(chip_t *chip, reset_cause_t cause)
{
    qtmr_catch_up(chip); /* the pins stay what they are */
    for (unsigned i = 0; i < CHIP_SOURCES_MOST; i++) {
        chip_set_turn(chip, i, CHIP_NEVER);
        chip_find_first(chip, i / CHIP_GROUP);
    }
    chip->quiet_turn = chip->turn[SOURCE_FAULT]; /* the lowest of them */
    core_reset(chip);
    system_reset(chip, cause);
    pwm_reset(chip);
    adc_reset(chip);
    qtmr_reset(chip);
    xbar_reset(chip);
    sci_reset(chip);
    pins_reroute(chip);
    ftfl_reset(chip);
    chip->must_boot = true;
    chip->alive = chip->alive && core_runs(chip); /* from outside: the software that ran is gone */
    longjmp(chip->escape, ESCAPE_RESET);
}

/* ---- access ------------------------------------------------------------------------------------------------------- */

typedef struct {
    uint32_t begin, end;
    uint16_t (*read)(chip_t *chip, uint32_t address);
    void (*write)(chip_t *chip, uint32_t address, uint16_t value);
} block_t;

static const block_t blocks[] = {
    /* in order of address */
    {0xE080, 0xE0B0, sci_read, sci_write},   {0xE140, 0xE1C0, qtmr_read, qtmr_write},
    {0xE200, 0xE270, gpio_read, gpio_write}, {0xE2B0, 0xE2B9, occs_read, occs_write},
    {0xE300, 0xE31C, intc_read, intc_write}, {0xE320, 0xE324, cop_read, cop_write},
    {0xE340, 0xE388, xbar_read, xbar_write}, {FTFL_BEGIN, FTFL_END, ftfl_read, ftfl_write},
    {0xE400, 0xE42E, sim_read, sim_write},   {0xE500, 0xE556, adc_read, adc_write},
    {0xE600, 0xE800, pwm_read, pwm_write},
};

/* The first block that may hold an address, by its bits 8 to 10. */
static const block_t *const first_block[8] = {&blocks[0], &blocks[1], &blocks[2],  &blocks[4],
                                              &blocks[8], &blocks[9], &blocks[10], &blocks[10]};

static inline const block_t *block_of(chip_t *chip, uint32_t address)
{
    if (address >> 11 != 0xE000u >> 11) {
        chip_no_register(chip, address);
    }
    const block_t *block = first_block[(address >> 8) & 7u];
    while (address >= block->end) {
        block++;
    }
    if (address < block->begin) {
        chip_no_register(chip, address);
    }
    return block;
}

CHIP_NORETURN NOINLINE static void fail_waiting(chip_t *chip, uint32_t address)
{
    char name[64];
    chip_register_name(address, name, sizeof name);
    chip_fail(chip, "the software waits for %s, which cannot change meanwhile", name);
}

static inline uint16_t read_register(chip_t *chip, uint32_t address)
{
    if (++chip->core.polls > POLLS_MAX) {
        fail_waiting(chip, address);
    }
    if (address >= FTFL_DATA_BEGIN && address < FTFL_DATA_END) {
        return ftfl_data_read(chip, address);
    }
    return block_of(chip, address)->read(chip, address);
}

static inline void write_register(chip_t *chip, uint32_t address, uint16_t value)
{
    chip_note(chip, TRACE_WRITE, address, value);
    block_of(chip, address)->write(chip, address, value);
}

/* What comes before the access takes its time, and while the software boots so does the access. */
static inline void reach(chip_t *chip)
{
    core_settle(chip);
    if (chip->core.booting) {
        core_busy(chip, chip->core.access_clocks);
    }
}

uint16_t chip_read(chip_t *chip, uint32_t address)
{
    reach(chip);
    const uint16_t value = read_register(chip, address);
    core_accessed(chip);
    return value;
}

void chip_write(chip_t *chip, uint32_t address, uint16_t value)
{
    reach(chip);
    write_register(chip, address, value);
    core_accessed(chip);
}

void chip_interrupts(chip_t *chip, bool on)
{
    chip->core.masked = !on;
    chip->core.changed = true;
}

/* ---- time --------------------------------------------------------------------------------------------------------- */

static inline void serve(chip_t *chip, unsigned source)
{
    if (source < SOURCE_FAULT) {
        pwm_event(chip, source - SOURCE_PWM);
    } else if (source == SOURCE_FAULT) {
        pwm_fault_event(chip);
    } else if (source < SOURCE_ADC) {
        qtmr_event(chip, source - SOURCE_TIMER);
    } else if (source < SOURCE_SERIAL) {
        adc_event(chip, source - SOURCE_ADC);
    } else if (source == SOURCE_SERIAL) {
        sci_event(chip);
    } else {
        cop_event(chip);
    }
}

/* Nothing happens any more before `until`. */
static bool stand_still(chip_t *chip, uint64_t until)
{
    if (until > chip->now) {
        chip_pass_time(chip, until);
    }
    return false;
}

/* The next event up to `until`, or else that clock itself; false then. */
static inline bool step(chip_t *chip, uint64_t until)
{
    const uint64_t turn = chip_next_turn(chip);
    const uint64_t clock = CHIP_TURN_CLOCK(turn);
    const uint64_t outside = world_next(chip->world);
    if (outside <= clock) { /* the world first: it may change what is due */
        if (outside > until) {
            return stand_still(chip, until);
        }
        chip_pass_time(chip, outside);
        sync_plant(chip);
        world_events(chip->world);
        return true;
    }
    if (clock > until) {
        return stand_still(chip, until);
    }
    chip_pass_time(chip, clock);
    serve(chip, CHIP_TURN_SOURCE(turn));
    return true;
}

static void leave(chip_t *chip)
{
    core_pause();
    (void)swapcontext(&chip->inside, &chip->outside);
    core_run(chip);
}

bool chip_step(chip_t *chip, uint64_t until)
{
    if (chip->stop) {
        leave(chip);
        return true;
    }
    if (chip->core.booting || until <= chip->limit) {
        return step(chip, until);
    }
    if (!step(chip, chip->limit)) {
        leave(chip);
    }
    return true;
}

/* Where the chip's life begins, with its address in two halves. */
static void inside(unsigned upper, unsigned lower)
{
    /* NOLINTNEXTLINE(performance-no-int-to-ptr): a context takes ints */
    chip_t *chip = (chip_t *)(uintptr_t)((uint64_t)upper << 32 | lower);
    core_run(chip);
    while (setjmp(chip->escape) == ESCAPE_FAILURE) {
        leave(chip);
    }
    if (chip->must_boot) {
        chip->must_boot = false;
        core_boot(chip);
    }
    core_live(chip);
}

static void enter(chip_t *chip)
{
    if (!chip->alive) {
        const uint64_t address = (uintptr_t)chip;
        (void)getcontext(&chip->inside);
        chip->inside.uc_stack.ss_sp = chip->stack;
        chip->inside.uc_stack.ss_size = sizeof chip->stack;
        chip->inside.uc_link = NULL;
        makecontext(&chip->inside, (void (*)(void))inside, 2, (unsigned)(address >> 32), (unsigned)address);
        chip->alive = true;
    }
    (void)swapcontext(&chip->outside, &chip->inside);
}

bool chip_run(chip_t *chip, uint64_t until)
{
    if (chip->failed) {
        return false;
    }
    chip->limit = until;
    enter(chip);
    if (!chip->failed) {
        qtmr_catch_up(chip);
    }
    return !chip->failed;
}

/* Errors of an access from outside end there. */
int32_t chip_peek(chip_t *chip, uint32_t address)
{
    jmp_buf within;
    volatile int32_t value = -1;
    memcpy(&within, &chip->escape, sizeof within);
    if (!chip->failed && setjmp(chip->escape) == 0) {
        chip->core.polls = 0;
        value = chip_read(chip, address);
    }
    memcpy(&chip->escape, &within, sizeof within);
    return value;
}

int chip_poke(chip_t *chip, uint32_t address, uint16_t value)
{
    jmp_buf within;
    volatile int result = chip->failed ? -1 : 0;
    memcpy(&within, &chip->escape, sizeof within);
    switch (setjmp(chip->escape)) {
    case 0:
        if (!chip->failed && !chip->must_boot) {
            chip_write(chip, address, value);
        }
        break;
    case ESCAPE_FAILURE:
        result = -1;
        break;
    default:
        break;
    }
    memcpy(&chip->escape, &within, sizeof within);
    return result;
}

void chip_init(chip_t *chip, const chip_config_t *config, void *world)
{
    memset(chip, 0, sizeof *chip);
    chip->config = *config;
    chip->world = world;
    flash_init(&chip->ftfl.flash, config->flash, config->seed);
    chip->line.byte_clocks = 10.0 * (double)CHIP_BUS_HZ / config->baud;
    chip->line.in_clock = CHIP_NEVER;
    if (setjmp(chip->escape) == 0) {
        chip_reset(chip, RESET_POWER_ON);
    }
}
