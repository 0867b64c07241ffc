#include "chip/pwm_parts.h"

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
    if (s->order == PWM_ORDER_KEPT) {
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

void pwm_settle(const chip_t *chip, pwm_submodule_t *s)
{
    if (s->running && !s->stuck) {
        settle_to(s, position(s, chip->now));
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
void pwm_watch(chip_t *chip, pwm_submodule_t *s)
{
    const pwm_t *pwm = pwm_of(chip, s);
    const unsigned resume_at_half = pwm->fsts_half;
    unsigned watched = (s->tctrl | s->inten) & 0x3Fu;
    watched |= 0x0Cu; /* PWM23 */
    if ((s->ctrl2 & CTRL2_INDEP) != 0) {
        watched |= 0x30u;
    }
    if (((s->ctrl & CTRL_HALF) != 0 && reloads_itself(s)) || (s->blocked & resume_at_half) != 0) {
        watched |= 1u;
    }
    if (watched != s->watched) {
        s->watched = watched;
        s->order = PWM_ORDER_STALE;
    }
    s->from_45 = ((pwm->ipol >> s->number) & 1u) != 0;
    const bool simple = (s->ctrl2 & CTRL2_INDEP) == 0 && !s->from_45;
    s->plain = simple ? 0x0Cu & ~(unsigned)(s->tctrl | s->inten) : 0u;
}

/* ---- the next event -------------------------------------------------------------------------------------------------- */

static void list_events(pwm_submodule_t *s)
{
    unsigned count = 0;
    for (unsigned k = 0; k < PWM_WRAP; k++) {
        if (((s->watched | BIT(PWM_CYCLE)) & BIT(k)) != 0) {
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
    s->order = PWM_ORDER_KEPT;
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

/* What has become an event only now, behind the counter, waits for the next cycle. */
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
    if (s->order == PWM_ORDER_KEPT) {
        s->next_clock = clock_of(s, *s->next);
    } else {
        find_anew(s, now);
    }
}

static inline uint64_t due(const pwm_submodule_t *s)
{
    return chip_sooner(s->sync_clock, chip_sooner(s->dead_clock, s->next_clock));
}

void pwm_schedule(chip_t *chip, pwm_submodule_t *s)
{
    find_next(s, chip->now);
    chip_move_turn(chip, s->id, due(s));
}

static void run(chip_t *chip, pwm_submodule_t *s);

/* ---- interrupts ---------------------------------------------------------------------------------------------------- */

static const uint8_t compare_vector[PWM_MODULES][PWM_SUBMODULES] = {{87, 85, 83, 81}, {76, 73, 70, 67}};
static const uint8_t reload_vector[PWM_MODULES][PWM_SUBMODULES] = {{86, 84, 82, 79}, {74, 71, 68, 65}};

void pwm_request(chip_t *chip, pwm_submodule_t *s)
{
    if ((s->inten & STS_CMPF) != 0) {
        pwm_settle(chip, s);
    }
    intc_request(chip, compare_vector[s->module][s->number], (s->flags & s->inten & STS_CMPF) != 0);
    intc_request(chip, reload_vector[s->module][s->number], (s->flags & s->inten & STS_RF) != 0);
    const pwm_submodule_t *all = pwm_of(chip, s)->sub;
    const unsigned errors = (all[0].flags & all[0].inten) | (all[1].flags & all[1].inten) |
                            (all[2].flags & all[2].inten) | (all[3].flags & all[3].inten);
    intc_request(chip, (s->module == 0) ? VECTOR_PWMA_RERR : VECTOR_PWMB_RERR, (errors & STS_REF) != 0);
}

void pwm_request_fault(chip_t *chip, unsigned m)
{
    const pwm_t *pwm = &chip->pwm[m];
    intc_request(chip, (m == 0) ? VECTOR_PWMA_FAULT : VECTOR_PWMB_FAULT, (pwm->fault_flag & pwm->fctrl & 0xFu) != 0);
}

/* ---- loading and cycles ---------------------------------------------------------------------------------------------- */

/* A cycle of one clock. */
static bool never_counts(const pwm_submodule_t *s)
{
    return CTRL2_INIT_SEL(s->ctrl2) == INIT_LOCAL && s->active.val[1] == s->active.init;
}

void pwm_load(chip_t *chip, pwm_submodule_t *s)
{
    pwm_t *pwm = pwm_of(chip, s);
    pwm_settle(chip, s);
    if (s->buffer.prescaler != s->active.prescaler && s->running) {
        s->base = pwm_counter(s, chip->now);
        s->origin = chip->now;
        s->done = s->settled = 0;
    }
    s->active = s->buffer;
    s->updated = false;
    pwm->ldok = (uint16_t)(pwm->ldok & ~BIT(s->number));
    find_distances(s);
    s->stuck = s->running && never_counts(s) && s->base == s->active.init;
    chip_note(chip, TRACE_LOAD, s->id, 0);
}

/* A reload point of a submodule: counts for LDFQ, then loads what is ready in it and in those that follow it. */
static void reload(chip_t *chip, pwm_submodule_t *s, bool at_end)
{
    const pwm_t *pwm = pwm_of(chip, s);
    if (++s->opportunities <= CTRL_LDFQ(s->ctrl)) {
        return;
    }
    s->opportunities = 0;
    for (pwm_submodule_t *other = s; other < pwm->sub + PWM_SUBMODULES; other++) {
        const bool follows = other == s || (s->number == 0 && (other->ctrl2 & CTRL2_RELOAD_SEL) != 0);
        if (!follows || !other->running) {
            continue;
        }
        other->flags = (uint16_t)(other->flags | STS_RF);
        if ((pwm->ldok & BIT(other->number)) != 0) {
            if (other != s && !at_end) { /* its matches of this clock see the old values */
                if (chip_is_due(chip, other->id)) {
                    run(chip, other);
                }
                const int64_t here = position(other, chip->now);
                other->done = (here > other->done) ? here : other->done;
            }
            pwm_load(chip, other);
        } else if (other->updated) {
            other->flags = (uint16_t)(other->flags | STS_REF);
        }
        if (CTRL2_FORCE_SEL(other->ctrl2) == FORCE_RELOAD) {
            pwm_force_out(chip, other);
        }
        if ((other->inten & (STS_RF | STS_REF)) != 0) {
            pwm_request(chip, other);
        }
        if (other != s) {
            find_next(other, chip->now);
            chip_set_turn(chip, other->id, due(other));
        }
    }
}

/* The counter begins anew from INIT in the present clock. */
void pwm_begin_cycle(chip_t *chip, pwm_submodule_t *s)
{
    s->origin = chip->now;
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
    chip_note(chip, TRACE_CYCLE, s->id, s->base);
    pwm_resume(chip, s, pwm_of(chip, s)->fsts_full);
}

/* What a submodule does at the local sync of submodule 0. */
static inline void follow_sync(chip_t *chip, pwm_submodule_t *s)
{
    if (CTRL2_INIT_SEL(s->ctrl2) == INIT_MASTER_SYNC) {
        const int64_t here = position(s, chip->now);
        if (here > 0) {
            settle_to(s, here - 1);
        }
        pwm_begin_cycle(chip, s);
    }
    if (CTRL2_FORCE_SEL(s->ctrl2) == FORCE_MASTER_SYNC) {
        pwm_force_out(chip, s);
    }
    find_next(s, chip->now);
    chip_set_turn(chip, s->id, due(s));
    if (chip_is_due(chip, s->id)) {
        run(chip, s);
    }
}

/* One past VAL1: the submodule's own sync. */
static void local_sync(chip_t *chip, pwm_submodule_t *s)
{
    settle_to(s, (int64_t)s->distance[PWM_CYCLE] - 1);
    s->done = s->distance[PWM_CYCLE];
    if ((s->ctrl & CTRL_FULL) != 0 && reloads_itself(s)) {
        reload(chip, s, true);
    }
    if (CTRL2_INIT_SEL(s->ctrl2) == INIT_LOCAL) {
        pwm_begin_cycle(chip, s);
    }
    if (CTRL2_FORCE_SEL(s->ctrl2) == FORCE_SYNC) {
        pwm_force_out(chip, s);
    }
    for (unsigned k = 1; s->number == 0 && k < PWM_SUBMODULES; k++) {
        if (s[k].running) {
            follow_sync(chip, &s[k]);
        }
    }
}

static void trigger(chip_t *chip, const pwm_submodule_t *s, unsigned odd)
{
    const unsigned n = s->number;
    const unsigned a = (s->module == 0) ? 20u + 2u * n + odd : (n < 3u) ? 40u + n : 43u + odd;
    const unsigned b = (s->module == 0) ? 8u + n : 22u + n;
    chip_note(chip, TRACE_TRIGGER, a, 0);
    xbar_signal(chip, (int)a, (int)b, XBAR_PULSE);
}

/* Watched compares at the distance d, in the present clock. */
static void matches(chip_t *chip, pwm_submodule_t *s, uint32_t d, unsigned hit)
{
    s->done = d;
    if ((hit & 0x3Cu) != 0) { /* equal edges: off */
        const unsigned on = ((hit >> 2) & 1u) | ((hit >> 3) & 2u);
        const unsigned off = ((hit >> 3) & 1u) | ((hit >> 4) & 2u);
        s->generated = (s->generated | on) & ~off;
        pwm_drive(chip, s);
    }
    const unsigned noted = hit & (s->tctrl | s->inten) & 0x3Fu;
    if (noted != 0) {
        for (unsigned left = noted; left != 0; left &= left - 1u) {
            chip_note(chip, TRACE_MATCH, s->id, chip_lowest_bit(left));
        }
        if ((noted & s->inten) != 0) {
            pwm_request(chip, s);
        }
        const unsigned triggers = hit & s->tctrl & 0x3Fu;
        if ((triggers & 0x15u) != 0) {
            trigger(chip, s, 0);
        }
        if ((triggers & 0x2Au) != 0) {
            trigger(chip, s, 1);
        }
    }
    if ((hit & 1u) != 0) {
        pwm_resume(chip, s, pwm_of(chip, s)->fsts_half);
        if ((s->ctrl & CTRL_HALF) != 0 && reloads_itself(s)) {
            reload(chip, s, false);
        }
    }
}

/* The counter's next events, all that share a distance. */
static void handle(chip_t *chip, pwm_submodule_t *s)
{
    const uint32_t d = PWM_EVENT_DISTANCE(*s->next);
    unsigned what = 0;
    do {
        what |= BIT(PWM_EVENT_NUMBER(*s->next++));
    } while (PWM_EVENT_DISTANCE(*s->next) == d);
    if ((what & BIT(PWM_CYCLE)) != 0) {
        local_sync(chip, s);
        if (s->done != (int64_t)d) {
            return; /* a new cycle */
        }
    }
    if ((what & BIT(PWM_WRAP)) != 0) {
        settle_to(s, (int64_t)WRAP_DISTANCE - 1);
        s->origin += (uint64_t)WRAP_DISTANCE << s->active.prescaler;
        s->done = s->settled = -1;
        s->next = s->event;
    } else if ((what & STS_CMPF) != 0) {
        matches(chip, s, d, what & STS_CMPF); /* unless it ends a cycle VAL1 + 1 is a count like any other */
    }
}

/* All events of a submodule up to the present clock. */
static void run(chip_t *chip, pwm_submodule_t *s)
{
    const bool synchronised = s->running && s->sync_clock <= chip->now;
    if (synchronised) {
        s->sync_clock = CHIP_NEVER;
        if (CTRL2_INIT_SEL(s->ctrl2) == INIT_EXT_SYNC) {
            const int64_t before = position(s, chip->now) - 1;
            const int64_t end = s->distance[PWM_CYCLE];
            settle_to(s, before);
            if (end > s->done && end <= before + 1) {
                local_sync(chip, s); /* its VAL1 was the count before */
            }
            pwm_begin_cycle(chip, s);
        }
    }
    if (s->next_clock <= chip->now || synchronised) {
        find_next(s, chip->now);
        while (s->next_clock <= chip->now) {
            handle(chip, s);
            find_next(s, chip->now);
        }
    }
    if (s->dead_clock <= chip->now) {
        pwm_end_dead_time(s);
        pwm_show(chip, s);
    }
    chip_set_turn(chip, s->id, due(s));
}

/* Most events are an edge of PWM23 that switches a pair or the end of a dead time, and nothing else. */
static inline bool only_switches(const pwm_submodule_t *s, uint64_t now)
{
    if (s->order != PWM_ORDER_KEPT || s->sync_clock <= now) {
        return false;
    }
    const uint32_t event = s->next[0];
    const bool plain = ((s->plain >> PWM_EVENT_NUMBER(event)) & 1u) != 0;
    return s->next_clock > now || (plain && (event ^ s->next[1]) >= PWM_EVENTS && s->dead_clock > now);
}

/* Such an event. When the next one is, is found before the world is told: a processor works ahead that far. */
static inline void switch_pair(chip_t *chip, pwm_submodule_t *s)
{
    if (s->next_clock > chip->now) {
        pwm_end_dead_time(s);
    } else {
        const uint32_t event = *s->next++;
        s->done = PWM_EVENT_DISTANCE(event);
        s->next_clock = clock_of(s, *s->next);
        s->generated = (s->generated & 2u) | (~event & 1u); /* VAL2 on, VAL3 off */
        pwm_drive_pair(chip, s, (((s->generated & s->followed) ^ s->given) & 1u) != 0);
    }
    chip_move_turn(chip, s->id, due(s));
    pwm_show(chip, s);
}

/* All events of a module in the present clock, beginning with submodule n of all modules'. */
void pwm_event(chip_t *chip, unsigned n)
{
    const unsigned m = n / PWM_SUBMODULES;
    do {
        pwm_submodule_t *s = chip->submodule[n];
        if (only_switches(s, chip->now)) {
            switch_pair(chip, s);
        } else {
            run(chip, s);
            chip_find_first(chip, m);
        }
        n = CHIP_TURN_SOURCE(chip->first[m]);
    } while (CHIP_TURN_CLOCK(chip->first[m]) <= chip->now);
}

void pwm_ext_sync(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = &chip->pwm[m].sub[n];
    if (s->running) {
        s->sync_clock = chip->now + chip->config.crossbar_clocks + 1u;
        pwm_schedule(chip, s);
    }
}

/* ---- start and stop ---------------------------------------------------------------------------------------------------- */

/* Submodule n counts while its RUN bit, or that of submodule 0 with whose clock it runs, and its gate are open. */
void pwm_follow_run(chip_t *chip, unsigned m)
{
    pwm_t *pwm = &chip->pwm[m];
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        pwm_submodule_t *s = &pwm->sub[n];
        const bool shared = n > 0 && CTRL2_CLK_SEL(s->ctrl2) == 2u;
        const bool clocked =
            sim_gate_open(chip, 3, ((m == 0) ? 7u : 3u) - n) && (!shared || sim_gate_open(chip, 3, (m == 0) ? 7u : 3u));
        const bool runs = clocked && ((pwm->run >> n) & (shared ? pwm->run : 1u) & 1u) != 0;
        if (runs == s->running) {
            continue;
        }
        if (runs) {
            occs_need_bus_clock(chip, "a PWM");
            if (((pwm->ldok >> n) & 1u) != 0) {
                pwm_load(chip, s);
            }
            s->running = true;
            pwm_begin_cycle(chip, s);
        } else {
            pwm_settle(chip, s);
            s->base = clocked ? s->active.init : pwm_counter(s, chip->now);
            s->running = false;
            s->order = PWM_ORDER_STALE;
            s->sync_clock = CHIP_NEVER;
        }
        pwm_schedule(chip, s);
    }
}

void pwm_gates_changed(chip_t *chip)
{
    pwm_follow_run(chip, 0);
    pwm_follow_run(chip, 1);
}

void pwm_reset(chip_t *chip)
{
    for (unsigned m = 0; m < PWM_MODULES; m++) {
        pwm_t *pwm = &chip->pwm[m];
        const unsigned pins = pwm->fault_pin;
        unsigned levels[PWM_SUBMODULES];
        for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
            levels[n] = pwm->sub[n].levels;
        }
        *pwm = (pwm_t){.fault_pin = pins, .fault_filtered = pins};
        for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
            pwm_submodule_t *s = &pwm->sub[n];
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
            chip->submodule[s->id] = s;
            find_distances(s);
            pwm_watch(chip, s);
        }
        for (unsigned i = 0; i < PWM_FAULTS; i++) {
            pwm->fault_clock[i] = CHIP_NEVER;
        }
        pwm_find_faults(chip, m); /* low is a fault until software says otherwise */
    }
}
