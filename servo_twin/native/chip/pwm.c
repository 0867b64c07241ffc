#include "chip/pwm_internal.h"

#define WRAP_DISTANCE UINT32_C(0x10000)
#define LAST_EVENT PWM_EVENT(WRAP_DISTANCE, PWM_WRAP)
#define BIT(k) (1u << (k))

/* ---- counter ------------------------------------------------------------------------------------------------------- */

static uint32_t distance_of(const pwm_submodule_t *s, uint16_t count) { return (uint16_t)(count - s->base); }

static int64_t position(const pwm_submodule_t *s, uint64_t now)
{
    return (int64_t)((now - s->origin) >> s->active.prescaler);
}

uint16_t pwm_counter(const pwm_submodule_t *s, uint64_t now)
{
    if (!s->running || s->stuck) {
        return s->base;
    }
    return (uint16_t)(s->base + position(s, now));
}

static void find_distances(pwm_submodule_t *s)
{
    for (unsigned k = 0; k < PWM_VALS; k++) {
        s->distance[k] = distance_of(s, s->active.val[k]);
    }
    s->distance[PWM_CYCLE] = s->distance[1] + 1u;
    s->distance[PWM_WRAP] = WRAP_DISTANCE;
    if (s->order == PWM_ORDER_VALID) {
        s->order = PWM_ORDER_MOVED;
    }
}

/* Flags of the compares up to the distance `to`. */
static void settle_to(pwm_submodule_t *s, int64_t to)
{
    if (to <= s->settled) {
        return;
    }
    if ((s->flags & STS_CMPF) == STS_CMPF) { /* nothing to add */
        s->settled = to;
        return;
    }
    for (unsigned k = 0; k < PWM_VALS; k++) {
        const int64_t d = s->distance[k];
        if (d > s->settled && d <= to) {
            s->flags = (uint16_t)(s->flags | (1u << k));
        }
    }
    s->settled = to;
}

void pwm_settle(const pwm_t *pwm, pwm_submodule_t *s)
{
    if (s->running && !s->stuck) {
        settle_to(s, position(s, pwm->bus->now));
    } else if (s->running) {
        for (unsigned k = 0; k < PWM_VALS; k++) {
            if (s->active.val[k] == s->base) {
                s->flags = (uint16_t)(s->flags | (1u << k));
            }
        }
    }
}

/* Loads and forces itself, rather than with submodule 0. */
static bool reloads_itself(const pwm_submodule_t *s) { return s->number == 0 || (s->ctrl2 & CTRL2_RELOAD_SEL) == 0; }

/* Which compares are events. */
void pwm_select_events(pwm_t *pwm, pwm_submodule_t *s)
{
    const pwm_module_t *module = module_of(pwm, s);
    const unsigned resume_at_half = module->fsts_half;
    unsigned eventful = (s->tctrl | s->inten) & 0x3Fu;
    eventful |= 0x0Cu; /* PWM23 */
    if ((s->ctrl2 & CTRL2_INDEP) != 0) {
        eventful |= 0x30u;
    }
    if (((s->ctrl & CTRL_HALF) != 0 && reloads_itself(s)) || (s->blocked & resume_at_half) != 0) {
        eventful |= 1u;
    }
    if (eventful != s->eventful) {
        s->eventful = eventful;
        s->order = PWM_ORDER_STALE;
    }
    s->from_45 = ((module->ipol >> s->number) & 1u) != 0;
    const bool simple = (s->ctrl2 & CTRL2_INDEP) == 0 && !s->from_45;
    s->plain = simple ? 0x0Cu & ~(unsigned)(s->tctrl | s->inten) : 0u;
}

/* ---- the next event -------------------------------------------------------------------------------------------------- */

static void list_events(pwm_submodule_t *s)
{
    unsigned count = 0;
    for (unsigned k = 0; k < PWM_WRAP; k++) {
        if (((s->eventful | BIT(PWM_CYCLE)) & BIT(k)) != 0) {
            s->event[count++] = PWM_EVENT(0, k);
        }
    }
    s->event[count++] = LAST_EVENT;
    s->event[count] = PWM_NO_EVENT;
}

/* Put the events of a cycle in order again: mostly they still are. */
static void sort_events(pwm_submodule_t *s)
{
    if (s->order == PWM_ORDER_STALE) {
        list_events(s);
    }
    s->order = PWM_ORDER_VALID;
    uint32_t before = 0;
    for (uint32_t *at = s->event; *at != LAST_EVENT; at++) {
        const unsigned number = PWM_EVENT_NUMBER(*at);
        const uint32_t event = PWM_EVENT(s->distance[number], number);
        if (event >= before) {
            *at = before = event;
            continue;
        }
        uint32_t *to = at;
        for (; to > s->event && to[-1] > event; to--) {
            *to = to[-1];
        }
        *to = event;
    }
}

static inline uint64_t clock_of(const pwm_submodule_t *s, uint32_t event)
{
    return s->origin + ((uint64_t)PWM_EVENT_DISTANCE(event) << s->active.prescaler);
}

/* A compare that becomes an event behind the count is first handled in the next cycle. */
static void find_anew(pwm_submodule_t *s, uint64_t now)
{
    if (!s->running || s->stuck) {
        s->next_clock = CHIP_NEVER;
        return;
    }
    sort_events(s);
    const uint32_t *next = s->event;
    while ((int64_t)PWM_EVENT_DISTANCE(*next) <= s->done || clock_of(s, *next) < now) {
        next++;
    }
    s->next = next;
    s->next_clock = clock_of(s, *next);
}

/* When the counter's next event is. */
static inline void find_next(pwm_submodule_t *s, uint64_t now)
{
    if (s->order == PWM_ORDER_VALID) {
        s->next_clock = clock_of(s, *s->next);
    } else {
        find_anew(s, now);
    }
}

static inline uint64_t due(const pwm_submodule_t *s)
{
    return events_earlier(s->sync_clock, events_earlier(s->dead_clock, s->next_clock));
}

void pwm_schedule(pwm_t *pwm, pwm_submodule_t *s)
{
    find_next(s, pwm->bus->now);
    bus_plan(pwm->bus, s->id, due(s));
}

static void run(pwm_t *pwm, pwm_submodule_t *s);

/* ---- interrupts ---------------------------------------------------------------------------------------------------- */

static const uint8_t compare_vector[PWM_MODULES][PWM_SUBMODULES] = {{87, 85, 83, 81}, {76, 73, 70, 67}};
static const uint8_t reload_vector[PWM_MODULES][PWM_SUBMODULES] = {{86, 84, 82, 79}, {74, 71, 68, 65}};

void pwm_request(pwm_t *pwm, pwm_submodule_t *s)
{
    if ((s->inten & STS_CMPF) != 0) {
        pwm_settle(pwm, s);
    }
    bus_request(pwm->bus, compare_vector[s->module][s->number], (s->flags & s->inten & STS_CMPF) != 0);
    bus_request(pwm->bus, reload_vector[s->module][s->number], (s->flags & s->inten & STS_RF) != 0);
    const pwm_submodule_t *all = module_of(pwm, s)->sub;
    const unsigned errors = (all[0].flags & all[0].inten) | (all[1].flags & all[1].inten) |
                            (all[2].flags & all[2].inten) | (all[3].flags & all[3].inten);
    bus_request(pwm->bus, (s->module == 0) ? VECTOR_PWMA_RERR : VECTOR_PWMB_RERR, (errors & STS_REF) != 0);
}

void pwm_request_fault(pwm_t *pwm, unsigned m)
{
    const pwm_module_t *module = &pwm->module[m];
    bus_request(pwm->bus, (m == 0) ? VECTOR_PWMA_FAULT : VECTOR_PWMB_FAULT,
                (module->fault_flag & module->reg[FCTRL0] & 0xFu) != 0);
}

/* ---- loading and cycles ---------------------------------------------------------------------------------------------- */

/* A cycle of one clock. */
static bool never_counts(const pwm_submodule_t *s)
{
    return CTRL2_INIT_SEL(s->ctrl2) == INIT_LOCAL && s->active.val[1] == s->active.init;
}

void pwm_load(pwm_t *pwm, pwm_submodule_t *s)
{
    pwm_module_t *module = module_of(pwm, s);
    pwm_settle(pwm, s);
    if (s->buffer.prescaler != s->active.prescaler && s->running) {
        s->base = pwm_counter(s, pwm->bus->now);
        s->origin = pwm->bus->now;
        s->done = s->settled = 0;
    }
    s->active = s->buffer;
    s->updated = false;
    module->ldok = (uint16_t)(module->ldok & ~BIT(s->number));
    find_distances(s);
    s->stuck = s->running && never_counts(s) && s->base == s->active.init;
    bus_note(pwm->bus, TRACE_LOAD, s->id, 0);
}

/* A reload point of a submodule: counts for LDFQ, then loads what is ready in it and in those that follow it. */
static void reload(pwm_t *pwm, pwm_submodule_t *s, bool at_end)
{
    const pwm_module_t *module = module_of(pwm, s);
    if (++s->opportunities <= CTRL_LDFQ(s->ctrl)) {
        return;
    }
    s->opportunities = 0;
    for (pwm_submodule_t *other = s; other < module->sub + PWM_SUBMODULES; other++) {
        const bool follows = other == s || (s->number == 0 && (other->ctrl2 & CTRL2_RELOAD_SEL) != 0);
        if (!follows || !other->running) {
            continue;
        }
        other->flags = (uint16_t)(other->flags | STS_RF);
        if ((module->ldok & BIT(other->number)) != 0) {
            if (other != s && !at_end) { /* its matches of this clock see the old values */
                if (bus_is_due(pwm->bus, other->id)) {
                    run(pwm, other);
                }
                const int64_t here = position(other, pwm->bus->now);
                other->done = (here > other->done) ? here : other->done;
            }
            pwm_load(pwm, other);
        } else if (other->updated) {
            other->flags = (uint16_t)(other->flags | STS_REF);
        }
        if (CTRL2_FORCE_SEL(other->ctrl2) == FORCE_RELOAD) {
            pwm_force_out(pwm, other);
        }
        if ((other->inten & (STS_RF | STS_REF)) != 0) {
            pwm_request(pwm, other);
        }
        if (other != s) {
            find_next(other, pwm->bus->now);
            events_set(&pwm->bus->events, other->id, due(other));
        }
    }
}

/* The counter begins anew from INIT in the present clock. */
void pwm_begin_cycle(pwm_t *pwm, pwm_submodule_t *s)
{
    s->origin = pwm->bus->now;
    s->done = s->settled = -1;
    s->next = s->event;
    if (s->base != s->active.init) {
        s->base = s->active.init;
        find_distances(s);
    }
    s->stuck = never_counts(s);
    if (s->stuck) {
        s->order = PWM_ORDER_STALE;
    }
    bus_note(pwm->bus, TRACE_CYCLE, s->id, s->base);
    pwm_resume(pwm, s, module_of(pwm, s)->fsts_full);
}

/* What a submodule does at the local sync of submodule 0. */
static inline void follow_sync(pwm_t *pwm, pwm_submodule_t *s)
{
    if (CTRL2_INIT_SEL(s->ctrl2) == INIT_MASTER_SYNC) {
        const int64_t here = position(s, pwm->bus->now);
        if (here > 0) {
            settle_to(s, here - 1);
        }
        pwm_begin_cycle(pwm, s);
    }
    if (CTRL2_FORCE_SEL(s->ctrl2) == FORCE_MASTER_SYNC) {
        pwm_force_out(pwm, s);
    }
    find_next(s, pwm->bus->now);
    events_set(&pwm->bus->events, s->id, due(s));
    if (bus_is_due(pwm->bus, s->id)) {
        run(pwm, s);
    }
}

/* One past VAL1: the submodule's own sync. */
static void local_sync(pwm_t *pwm, pwm_submodule_t *s)
{
    settle_to(s, (int64_t)s->distance[PWM_CYCLE] - 1);
    s->done = s->distance[PWM_CYCLE];
    if ((s->ctrl & CTRL_FULL) != 0 && reloads_itself(s)) {
        reload(pwm, s, true);
    }
    if (CTRL2_INIT_SEL(s->ctrl2) == INIT_LOCAL) {
        pwm_begin_cycle(pwm, s);
    }
    if (CTRL2_FORCE_SEL(s->ctrl2) == FORCE_SYNC) {
        pwm_force_out(pwm, s);
    }
    for (unsigned k = 1; s->number == 0 && k < PWM_SUBMODULES; k++) {
        if (s[k].running) {
            follow_sync(pwm, &s[k]);
        }
    }
}

static void trigger(pwm_t *pwm, const pwm_submodule_t *s, unsigned odd)
{
    const unsigned n = s->number;
    const unsigned a = (s->module == 0) ? 20u + 2u * n + odd : (n < 3u) ? 40u + n : 43u + odd;
    const unsigned b = (s->module == 0) ? 8u + n : 22u + n;
    bus_note(pwm->bus, TRACE_TRIGGER, a, 0);
    pwm->bus->signals->crossbar(pwm->bus->chip, (int)a, (int)b, XBAR_PULSE);
}

/* Compares that are events at the distance d, in the present clock. */
static void matches(pwm_t *pwm, pwm_submodule_t *s, uint32_t d, unsigned hit)
{
    s->done = d;
    if ((hit & 0x3Cu) != 0) { /* equal edges: off */
        const unsigned on = ((hit >> 2) & 1u) | ((hit >> 3) & 2u);
        const unsigned off = ((hit >> 3) & 1u) | ((hit >> 4) & 2u);
        s->generated = (s->generated | on) & ~off;
        pwm_drive(pwm, s);
    }
    const unsigned noted = hit & (s->tctrl | s->inten) & 0x3Fu;
    if (noted != 0) {
        for (unsigned remaining = noted; remaining != 0; remaining &= remaining - 1u) {
            bus_note(pwm->bus, TRACE_MATCH, s->id, lowest_bit(remaining));
        }
        if ((noted & s->inten) != 0) {
            pwm_request(pwm, s);
        }
        const unsigned triggers = hit & s->tctrl & 0x3Fu;
        if ((triggers & 0x15u) != 0) {
            trigger(pwm, s, 0);
        }
        if ((triggers & 0x2Au) != 0) {
            trigger(pwm, s, 1);
        }
    }
    if ((hit & 1u) != 0) {
        pwm_resume(pwm, s, module_of(pwm, s)->fsts_half);
        if ((s->ctrl & CTRL_HALF) != 0 && reloads_itself(s)) {
            reload(pwm, s, false);
        }
    }
}

/* The counter's next events, all that share a distance. */
static void handle(pwm_t *pwm, pwm_submodule_t *s)
{
    const uint32_t d = PWM_EVENT_DISTANCE(*s->next);
    unsigned events = 0;
    do {
        events |= BIT(PWM_EVENT_NUMBER(*s->next++));
    } while (PWM_EVENT_DISTANCE(*s->next) == d);
    if ((events & BIT(PWM_CYCLE)) != 0) {
        local_sync(pwm, s);
        if (s->done != (int64_t)d) {
            return; /* a new cycle */
        }
    }
    if ((events & BIT(PWM_WRAP)) != 0) {
        settle_to(s, (int64_t)WRAP_DISTANCE - 1);
        s->origin += (uint64_t)WRAP_DISTANCE << s->active.prescaler;
        s->done = s->settled = -1;
        s->next = s->event;
    } else if ((events & STS_CMPF) != 0) {
        matches(pwm, s, d, events & STS_CMPF); /* unless it ends a cycle VAL1 + 1 is a count like any other */
    }
}

/* All events of a submodule up to the present clock; the smallest key of the module is not found yet. */
static void run(pwm_t *pwm, pwm_submodule_t *s)
{
    const bool synchronised = s->running && s->sync_clock <= pwm->bus->now;
    if (synchronised) {
        s->sync_clock = CHIP_NEVER;
        if (CTRL2_INIT_SEL(s->ctrl2) == INIT_EXT_SYNC) {
            const int64_t before = position(s, pwm->bus->now) - 1;
            const int64_t end = s->distance[PWM_CYCLE];
            settle_to(s, before);
            if (end > s->done && end <= before + 1) {
                local_sync(pwm, s); /* its VAL1 was the count before */
            }
            pwm_begin_cycle(pwm, s);
        }
    }
    if (s->next_clock <= pwm->bus->now || synchronised) {
        find_next(s, pwm->bus->now);
        while (s->next_clock <= pwm->bus->now) {
            handle(pwm, s);
            find_next(s, pwm->bus->now);
        }
    }
    if (s->dead_clock <= pwm->bus->now) {
        pwm_end_dead_time(s);
        pwm_update_pins(pwm, s);
    }
    events_set(&pwm->bus->events, s->id, due(s));
}

/* Most events are an edge of PWM23 that switches a pair or the end of a dead time, and nothing else. */
static inline bool only_switches(const pwm_submodule_t *s, uint64_t now)
{
    if (s->order != PWM_ORDER_VALID || s->sync_clock <= now) {
        return false;
    }
    const uint32_t event = s->next[0];
    const bool plain = ((s->plain >> PWM_EVENT_NUMBER(event)) & 1u) != 0;
    return s->next_clock > now || (plain && (event ^ s->next[1]) >= PWM_EVENTS && s->dead_clock > now);
}

/* Such an event. The next one is found before the environment is called, so that a processor can compute it in parallel. */
static inline void switch_pair(pwm_t *pwm, pwm_submodule_t *s)
{
    if (s->next_clock > pwm->bus->now) {
        pwm_end_dead_time(s);
    } else {
        const uint32_t event = *s->next++;
        s->done = PWM_EVENT_DISTANCE(event);
        s->next_clock = clock_of(s, *s->next);
        s->generated = (s->generated & 2u) | (~event & 1u); /* VAL2 on, VAL3 off */
        pwm_drive_pair(pwm, s, (((s->generated & s->followed) ^ s->given) & 1u) != 0);
    }
    bus_plan(pwm->bus, s->id, due(s));
    pwm_update_pins(pwm, s);
}

/* All events of a module at the present clock, beginning with `source`. */
void pwm_event(void *peripheral, unsigned source)
{
    pwm_t *pwm = (pwm_t *)peripheral;
    const uint64_t *first = &pwm->bus->events.first[source / EVENT_GROUP];
    do {
        pwm_submodule_t *s = pwm->submodule[source];
        if (only_switches(s, pwm->bus->now)) {
            switch_pair(pwm, s);
        } else {
            run(pwm, s);
            events_find_first(&pwm->bus->events, source / EVENT_GROUP);
        }
        source = EVENT_SOURCE(*first);
    } while (EVENT_CLOCK(*first) <= pwm->bus->now);
}

void pwm_ext_sync(pwm_t *pwm, unsigned m, unsigned n)
{
    pwm_submodule_t *s = &pwm->module[m].sub[n];
    if (s->running) {
        s->sync_clock = pwm->bus->now + pwm->bus->crossbar_clocks + 1u;
        pwm_schedule(pwm, s);
    }
}

/* ---- start and stop ---------------------------------------------------------------------------------------------------- */

/* Submodule n counts while its RUN bit, or that of submodule 0 with whose clock it runs, and its gate are open. */
void pwm_follow_run(pwm_t *pwm, unsigned m)
{
    pwm_module_t *module = &pwm->module[m];
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        pwm_submodule_t *s = &module->sub[n];
        const bool shared = n > 0 && CTRL2_CLK_SEL(s->ctrl2) == 2u;
        const bool clocked = bus_gate_open(pwm->bus, 3, ((m == 0) ? 7u : 3u) - n) &&
                             (!shared || bus_gate_open(pwm->bus, 3, (m == 0) ? 7u : 3u));
        const bool runs = clocked && ((module->run >> n) & (shared ? module->run : 1u) & 1u) != 0;
        if (runs == s->running) {
            continue;
        }
        if (runs) {
            pwm->bus->signals->need_bus_clock(pwm->bus->chip, "a PWM");
            if (((module->ldok >> n) & 1u) != 0) {
                pwm_load(pwm, s);
            }
            s->running = true;
            pwm_begin_cycle(pwm, s);
        } else {
            pwm_settle(pwm, s);
            s->base = clocked ? s->active.init : pwm_counter(s, pwm->bus->now);
            s->running = false;
            s->order = PWM_ORDER_STALE;
            s->sync_clock = CHIP_NEVER;
        }
        pwm_schedule(pwm, s);
    }
}

void pwm_gates_changed(pwm_t *pwm)
{
    pwm_follow_run(pwm, 0);
    pwm_follow_run(pwm, 1);
}

void pwm_reset(void *peripheral)
{
    pwm_t *pwm = (pwm_t *)peripheral;
    for (unsigned m = 0; m < PWM_MODULES; m++) {
        pwm_module_t *module = &pwm->module[m];
        const unsigned pins = module->fault_pin;
        unsigned levels[PWM_SUBMODULES];
        for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
            levels[n] = module->sub[n].levels;
        }
        *module = (pwm_module_t){.fault_pin = pins, .fault_filtered = pins};
        for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
            pwm_submodule_t *s = &module->sub[n];
            *s = (pwm_submodule_t){
                .id = (uint8_t)(PWM_SUBMODULES * m + n),
                .module = (uint8_t)m,
                .number = (uint8_t)n,
                .ctrl = CTRL_FULL,
                .dismap0 = 0xFFFF,
                .dismap1 = 0xFFFF,
                .dtcnt = {0x7FF, 0x7FF},
                .sync_clock = CHIP_NEVER,
                .dead_clock = CHIP_NEVER,
                .next_clock = CHIP_NEVER,
                .out = 2u,
                .followed = 3u,
                .order = PWM_ORDER_STALE,
                .done = -1,
                .settled = -1,
                .levels = levels[n],
            };
            pwm->submodule[s->id] = s;
            find_distances(s);
            pwm_select_events(pwm, s);
        }
        for (unsigned i = 0; i < PWM_FAULTS; i++) {
            module->fault_clock[i] = CHIP_NEVER;
        }
        pwm_find_faults(pwm, m); /* low is a fault until software says otherwise */
    }
}
