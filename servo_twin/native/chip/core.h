/* core.h - the core: it runs the software and the events of the peripherals in the order of their clocks.
 *
 * The software reports by core_time.h how much time it has taken: an access to a register happens at its clock, and an interrupt
 * of a higher level comes between two statements. Software without charges takes no time but what the environment's `interrupt`
 * returns. Events and software run on a stack of their own, so that core_run can end in the middle of a handler.
 */
#ifndef CHIP_CORE_H
#define CHIP_CORE_H

#include <ucontext.h>

#include "chip/intc.h"

#define CORE_BACKGROUND (-1) /* level of the background software, below all interrupts */
#define CORE_STACK 0x40000   /* stack of the software and of the host code called by it [bytes] */

typedef struct {
    double cycles_per_instruction; /* [1] */
    unsigned entry_clocks; /* overhead of an interrupt: vector, registers saved and restored */
} core_speed_t;

typedef struct {
    bus_t bus; /* embedded, as each step reads it */
    intc_t *intc;
    core_speed_t speed;
    int level;            /* level of the running handler */
    bool running;         /* the software of this core runs in the present thread */
    bool booting;         /* accesses take time, interrupts are masked */
    bool masked;          /* all interrupts of peripherals */
    uint64_t unit_clocks; /* duration of 1/16 instruction [2^-20 clocks] */
    int given;            /* charge until the next event, when time last moved [1/16 instruction] */
    uint64_t next;        /* clock of the event that was next when the core last looked for one */
    uint64_t horizon;     /* clock before which there is no event; 0: unknown */
    uint64_t part;        /* charged since time last moved, less than a clock [2^-20 clocks] */
    bool stop_resting;    /* end core_run as soon as the core rests */
    bool resting;         /* no software has begun: a core that is started anew continues in the same way */
    bool alive;           /* `inside` is suspended */
    ucontext_t inside, outside;
    uint8_t *stack; /* CORE_STACK bytes */
} core_t;

void core_init(core_t *core, intc_t *intc, const core_speed_t *speed, uint8_t *stack);

/* The software starts anew in the next core_run, or at once if it has caused the reset. */
void core_reset(core_t *core);

/* All events and software up to and including `until`, unless an error or `stop` ends it; booting may take longer. */
void core_run(core_t *core, uint64_t until);

/* Let the time pass that the software has been charged with up to here. */
void core_settle(core_t *core);

/* Execute software for a number of clocks; interrupting handlers take additional clocks. */
void core_busy(core_t *core, uint64_t clocks);

/* Charge the software with the time until the next event. */
void core_give(core_t *core);

/* Before and after an access to a register, after which the next event may be nearer. */
static inline void core_before_access(core_t *core)
{
    core_settle(core);
    if (core->booting) {
        core_busy(core, core->bus.access_clocks);
    }
}

static inline void core_after_access(core_t *core)
{
    const uint64_t horizon = core->horizon;
    if (core->running && (horizon == 0 || EVENT_CLOCK(events_next(&core->bus.events)) < horizon)) {
        core_give(core);
    }
}

#endif
