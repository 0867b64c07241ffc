#include "chip/core.h"

#include "chip/core_time.h"

#include <limits.h>

#define UNITS 16.0 /* per instruction */
#define PART_BITS 20

/* The core whose software runs in this thread. */
static CORE_THREAD core_t *running;
CORE_THREAD int core_left = INT_MAX;

/* ---- events --------------------------------------------------------------------------------------------------------- */

static inline bool step(core_t *core, uint64_t until) { return bus_step(&core->bus, until, &core->next); }

static void enter(core_t *core)
{
    running = core;
    core->running = true;
}

static void leave(core_t *core)
{
    running = NULL;
    core_left = INT_MAX;
    core->running = false;
    (void)swapcontext(&core->inside, &core->outside);
    enter(core);
}

/* As step(); suspended at the end of a core_run. */
static bool run_event(core_t *core, uint64_t until)
{
    if (core->bus.stop) {
        leave(core);
        return true;
    }
    if (core->booting || until <= core->bus.limit) {
        return step(core, until);
    }
    if (!step(core, core->bus.limit)) {
        leave(core);
    }
    return true;
}

/* ---- charges -------------------------------------------------------------------------------------------------------- */

static inline void give_until(core_t *core, uint64_t event)
{
    const bus_t *bus = &core->bus;
    const uint64_t next = events_earlier(event, core->bus.limit);
    const uint64_t clocks = (next > bus->now) ? next - bus->now : 0;
    core->horizon = next;
    const bool far = core->unit_clocks == 0 || clocks > UINT32_MAX;
    const uint64_t units = far ? INT_MAX : (clocks << PART_BITS) / core->unit_clocks;
    core->given = (units < INT_MAX) ? (int)units : INT_MAX;
    core_left = core->given;
}

void core_give(core_t *core)
{
    const bus_t *bus = &core->bus;
    give_until(core, events_earlier(EVENT_CLOCK(events_next(&bus->events)), bus_next_of_plant(bus)));
}

void core_settle(core_t *core)
{
    const bus_t *bus = &core->bus;
    if (!core->running) {
        return;
    }
    core->part += (uint64_t)((int64_t)core->given - core_left) * core->unit_clocks;
    core->given = core_left;
    const uint64_t clocks = core->part >> PART_BITS;
    core->part &= (1u << PART_BITS) - 1u;
    if (clocks == 0) {
        return;
    }
    if (bus->now + clocks < core->horizon && !bus->changed && !core->bus.stop) {
        bus_pass_time(&core->bus, bus->now + clocks); /* almost always */
    } else {
        core_busy(core, clocks);
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

/* ---- software ------------------------------------------------------------------------------------------------------- */

NOINLINE static void run_handler(core_t *core, unsigned vector, int level)
{
    bus_t *bus = &core->bus;
    const int outer = core->level;
    const uint64_t part = core->part;
    core->level = level;
    core->part = 0;
    bus_note(bus, TRACE_ENTER, vector, (uint32_t)level);
    core_busy(core, core->speed.entry_clocks);
    const uint32_t more = bus->environment->interrupt(bus->board, vector);
    core_settle(core);
    core_busy(core, more);
    core->level = outer;
    core->part = part;
    bus_note(bus, TRACE_LEAVE, vector, 0);
    bus_wake_background(bus);
}

NOINLINE static void serve_requests(core_t *core)
{
    bus_t *bus = &core->bus;
    while (bus->changed) {
        unsigned vector;
        int level;
        bus->changed = false;
        if (!core->booting && !core->masked && intc_most_urgent(core->intc, core->level, &vector, &level)) {
            run_handler(core, vector, level);
        }
    }
}

/* All events of one clock come before a handler. */
static inline void start_handlers(core_t *core)
{
    const bus_t *bus = &core->bus;
    if (bus->changed && EVENT_CLOCK(events_next(&bus->events)) > bus->now) {
        serve_requests(core);
    }
}

void core_busy(core_t *core, uint64_t clocks)
{
    uint64_t end = core->bus.now + clocks;
    while (run_event(core, end) || core->bus.changed) {
        const uint64_t begin = core->bus.now;
        start_handlers(core);
        end += core->bus.now - begin;
    }
    give_until(core, core->next);
}

static void boot(core_t *core)
{
    core->bus.must_boot = false;
    core->booting = true;
    core_give(core);
    core->bus.environment->boot(core->bus.board);
    core_settle(core);
    core->booting = false;
}

/* Handlers and background, when they are due. */
CHIP_NORETURN static void live(core_t *core)
{
    bus_t *bus = &core->bus;
    for (;;) {
        start_handlers(core);
        if (bus->background_due && !bus->changed) {
            bus->background_due = false;
            core_give(core);
            bus->environment->background(bus->board);
            core_settle(core);
            bus->changed = bus->background_due; /* due again */
        }
        core->resting = !bus->changed;
        core->given = 0; /* its rest depends on where runs have ended; states are compared */
        core->bus.stop = core->bus.stop || (core->stop_resting && core->resting);
        (void)run_event(core, CHIP_NEVER);
        core->resting = false;
    }
}

/* Entry of the context, with the address of the core in two halves. */
static void inside(unsigned upper, unsigned lower)
{
    /* NOLINTNEXTLINE(performance-no-int-to-ptr): a context takes ints */
    core_t *core = (core_t *)(uintptr_t)((uint64_t)upper << 32 | lower);
    enter(core);
    while (setjmp(core->bus.escape) == ESCAPE_FAILURE) {
        leave(core);
    }
    if (core->bus.must_boot) {
        boot(core);
    }
    live(core);
}

void core_run(core_t *core, uint64_t until)
{
    core->bus.limit = until;
    if (!core->alive) {
        const uint64_t address = (uintptr_t)core;
        (void)getcontext(&core->inside);
        core->inside.uc_stack.ss_sp = core->stack;
        core->inside.uc_stack.ss_size = CORE_STACK;
        core->inside.uc_link = NULL;
        makecontext(&core->inside, (void (*)(void))inside, 2, (unsigned)(address >> 32), (unsigned)address);
        core->alive = true;
    }
    (void)swapcontext(&core->outside, &core->inside);
}

void core_reset(core_t *core)
{
    core->level = CORE_BACKGROUND;
    core->masked = true;
    core->booting = false;
    core->given = 0;
    core->horizon = 0;
    core->part = 0;
    core->bus.must_boot = true;
    core->resting = false;
    core->alive = core->alive && core->running; /* otherwise the context is abandoned */
    core->bus.changed = true;
    core->bus.background_due = false;
    core->bus.polls = 0;
}

void core_init(core_t *core, intc_t *intc, const core_speed_t *speed, uint8_t *stack)
{
    core->intc = intc;
    core->speed.cycles_per_instruction = speed->cycles_per_instruction; /* without padding: states are compared */
    core->speed.entry_clocks = speed->entry_clocks;
    core->stack = stack;
    core->unit_clocks = (uint64_t)(speed->cycles_per_instruction / UNITS * (double)(1u << PART_BITS) + 0.5);
}
