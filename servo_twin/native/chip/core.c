#include "chip/core.h"

#include "chip/core_time.h"
#include "chip/parts.h"

#include <limits.h>

#define IPR_FIRST 0xE300u
#define VBA 0xE30Du
#define FIM0 0xE30Eu
#define IRQP0 0xE314u
#define INTC_CTRL 0xE31Bu
#define INTC_CTRL_INT_DIS 0x0020u

#define UNITS 16.0 /* per instruction */
#define PART_BITS 20

void core_reset(chip_t *chip)
{
    const double unit = chip->config.core.cycles_per_instruction / UNITS * (double)(1u << PART_BITS);
    chip->core = (core_t){.masked = true,
                          .changed = true,
                          .access_clocks = 4,
                          .level = CORE_BACKGROUND,
                          .unit_clocks = (uint64_t)(unit + 0.5)};
}

/* ---- interrupt controller ----------------------------------------------------------------------------------------- */

/* Peripherals have their fields in the order of their vectors; code c is level c - 1 from the timers on. */
static void enable_vectors(chip_t *chip)
{
    core_t *core = &chip->core;
    for (int level = 0; level < CORE_LEVELS; level++) {
        core->enabled[level][0] = core->enabled[level][1] = 0;
    }
    for (unsigned vector = VECTOR_TMRB3; vector <= VECTOR_COP; vector++) {
        const unsigned index = vector - 9u;
        const unsigned code = (core->ipr[index / 8u] >> (2u * (index % 8u))) & 3u;
        if (code > 0) {
            core->enabled[code - 1u][vector >> 6] |= UINT64_C(1) << (vector & 63u);
        }
    }
    core->changed = true;
}

uint16_t intc_read(chip_t *chip, uint32_t address)
{
    const core_t *core = &chip->core;
    if (address < VBA) {
        return core->ipr[address - IPR_FIRST];
    }
    if (address == VBA) {
        return core->vba;
    }
    if (address >= IRQP0 && address < INTC_CTRL) {
        const unsigned first = (address - IRQP0) * 16u;
        uint16_t pending = 0xFFFF; /* active low */
        for (unsigned bit = 0; bit < 16u && first + bit < CORE_VECTORS; bit++) {
            const unsigned vector = first + bit;
            if (((core->request[vector >> 6] >> (vector & 63u)) & 1u) != 0) {
                pending = (uint16_t)(pending & ~(1u << bit));
            }
        }
        return pending;
    }
    if (address == INTC_CTRL) {
        return core->ctrl;
    }
    chip_no_register(chip, address);
}

void intc_write(chip_t *chip, uint32_t address, uint16_t value)
{
    core_t *core = &chip->core;
    if (address < VBA) {
        core->ipr[address - IPR_FIRST] = value;
        enable_vectors(chip);
    } else if (address == VBA) {
        core->vba = value & 0x1FFFu;
    } else if (address >= FIM0 && address < IRQP0) {
        chip_only(chip, address, value, 0, "fast interrupts are not modelled");
    } else if (address == INTC_CTRL) {
        core->ctrl = value & INTC_CTRL_INT_DIS;
        core->changed = true;
    } else {
        chip_no_register(chip, address);
    }
}

/* Most urgent request above `level`; the lower vector of two at one level. */
static bool most_urgent(const core_t *core, int level, unsigned *vector, int *its_level)
{
    for (int l = CORE_LEVELS - 1; l > level; l--) {
        for (unsigned word = 0; word < 2u; word++) {
            const uint64_t pending = core->request[word] & core->enabled[l][word];
            if (pending != 0) {
                *vector = 64u * word + chip_lowest_bit(pending);
                *its_level = l;
                return true;
            }
        }
    }
    return false;
}

/* ---- the core's time ---------------------------------------------------------------------------------------------- */

/* The chip whose software runs in this thread. */
static CORE_THREAD chip_t *running;
CORE_THREAD int core_left = INT_MAX;

/* From now on charges are paid from the time until the next event. */
static void give(chip_t *chip)
{
    core_t *core = &chip->core;
    const uint64_t event = chip_sooner(CHIP_TURN_CLOCK(chip_next_turn(chip)), world_next(chip->world));
    const uint64_t next = chip_sooner(event, chip->limit);
    const uint64_t clocks = (next > chip->now) ? next - chip->now : 0;
    core->horizon = next;
    const bool far = core->unit_clocks == 0 || clocks > UINT32_MAX;
    const uint64_t units = far ? INT_MAX : (clocks << PART_BITS) / core->unit_clocks;
    core->given = (units < INT_MAX) ? (int)units : INT_MAX;
    core_left = core->given;
}

/* What has been spent since takes its time. */
void core_settle(chip_t *chip)
{
    if (running != chip) {
        return;
    }
    core_t *core = &chip->core;
    core->part += (uint64_t)((int64_t)core->given - core_left) * core->unit_clocks;
    core->given = core_left;
    const uint64_t clocks = core->part >> PART_BITS;
    core->part &= (1u << PART_BITS) - 1u;
    if (clocks == 0) {
        return;
    }
    if (chip->now + clocks < core->horizon && !core->changed && !chip->stop) {
        chip_pass_time(chip, chip->now + clocks); /* almost always */
    } else {
        core_busy(chip, clocks);
    }
}

void core_accessed(chip_t *chip)
{
    const uint64_t horizon = chip->core.horizon;
    if (running == chip && (horizon == 0 || CHIP_TURN_CLOCK(chip_next_turn(chip)) < horizon)) {
        give(chip);
    }
}

void core_look(void)
{
    if (running == NULL) {
        core_left = INT_MAX;
    } else {
        core_settle(running);
    }
}

#if !defined(__x86_64__)
void core_spend(int units)
{
    core_left -= units;
    if (core_left < 0) {
        core_look();
    }
}
#endif

NOINLINE static void start(chip_t *chip, unsigned vector, int level)
{
    core_t *core = &chip->core;
    const int outer = core->level;
    const uint64_t part = core->part;
    core->level = level;
    core->part = 0;
    chip_note(chip, TRACE_ENTER, vector, (uint32_t)level);
    core_busy(chip, chip->config.core.entry_clocks);
    const uint32_t more = world_interrupt(chip->world, vector);
    core_settle(chip);
    core_busy(chip, more);
    core->level = outer;
    core->part = part;
    chip_note(chip, TRACE_LEAVE, vector, 0);
    core_wake(chip);
}

NOINLINE static void look_for_requests(chip_t *chip)
{
    core_t *core = &chip->core;
    while (core->changed) {
        core->changed = false;
        if (core->booting || core->masked || (core->ctrl & INTC_CTRL_INT_DIS) != 0) {
            break;
        }
        unsigned vector;
        int level;
        if (most_urgent(core, core->level, &vector, &level)) {
            start(chip, vector, level);
        }
    }
}

/* All that happens in one clock comes before a handler. */
static inline void start_handlers(chip_t *chip)
{
    if (chip->core.changed && CHIP_TURN_CLOCK(chip_next_turn(chip)) > chip->now) {
        look_for_requests(chip);
    }
}

/* The software works for so many clocks; handlers that interrupt it are not among them. */
void core_busy(chip_t *chip, uint64_t clocks)
{
    uint64_t end = chip->now + clocks;
    bool on = true;
    while (on) {
        on = chip_step(chip, end);
        const uint64_t begin = chip->now;
        start_handlers(chip);
        end += chip->now - begin;
        on = on || chip->now > begin;
    }
    give(chip);
}

void core_live(chip_t *chip)
{
    core_t *core = &chip->core;
    for (;;) {
        start_handlers(chip);
        if (core->background_due && !core->changed) {
            core->background_due = false;
            give(chip);
            world_background(chip->world);
            core_settle(chip);
            core->changed = core->background_due; /* it has woken itself */
        }
        (void)chip_step(chip, CHIP_NEVER);
    }
}

void core_boot(chip_t *chip)
{
    chip->core.booting = true;
    give(chip);
    world_boot(chip->world);
    core_settle(chip);
    chip->core.booting = false;
}

void core_run(chip_t *chip) { running = chip; }

bool core_runs(const chip_t *chip) { return running == chip; }

void core_pause(void)
{
    running = NULL;
    core_left = INT_MAX;
}
