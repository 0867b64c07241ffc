#include "chip/pwm_parts.h"

#define WRAP_DISTANCE UINT32_C(0x10000)
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

/* Which compares are events. */
void pwm_watch(pwm_t *pwm, unsigned n)
{
    pwm_submodule_t *s = &pwm->sub[n];
    const unsigned resume_at_half = pwm->fsts_half;
    unsigned watched = (s->tctrl | s->inten) & 0x3Fu;
    watched |= 0x0Cu; /* PWM23 */
    if ((s->ctrl2 & CTRL2_INDEP) != 0) {
        watched |= 0x30u;
    }
    const bool own_reload = n == 0 || (s->ctrl2 & CTRL2_RELOAD_SEL) == 0;
    if (((s->ctrl & CTRL_HALF) != 0 && own_reload) || (s->blocked & resume_at_half) != 0) {
        watched |= 1u;
    }
    if (watched != s->watched) {
        s->watched = watched;
        s->order = PWM_ORDER_STALE;
    }
    const bool simple = (s->ctrl2 & CTRL2_INDEP) == 0 && ((pwm->ipol >> n) & 1u) == 0;
    s->plain = simple ? 0x0Cu & ~(unsigned)(s->tctrl | s->inten) : 0u;
}

/* Put the events of a cycle in order again: mostly they still are. */
static void sort_events(pwm_submodule_t *s)
{
    if (s->order == PWM_ORDER_STALE) {
        unsigned count = 0;
        for (unsigned k = 0; k < PWM_EVENTS; k++) {
            if (((s->watched | BIT(PWM_CYCLE) | BIT(PWM_WRAP)) & BIT(k)) != 0) {
                s->event[count++] = PWM_EVENT(0, k);
            }
        }
        s->event[count] = PWM_NO_EVENT;
    }
    for (unsigned i = 0; s->event[i] != PWM_NO_EVENT; i++) {
        const unsigned number = PWM_EVENT_NUMBER(s->event[i]);
        const uint32_t event = PWM_EVENT(s->distance[number], number);
        unsigned at = i;
        for (; at > 0 && s->event[at - 1u] > event; at--) {
            s->event[at] = s->event[at - 1u];
        }
        s->event[at] = event;
    }
    s->order = PWM_ORDER_KEPT;
}

static inline uint64_t clock_of(const pwm_submodule_t *s, uint32_t event)
{
    return s->origin + ((uint64_t)PWM_EVENT_DISTANCE(event) << s->active.prescaler);
}

/* When the counter's next event is. What has become one only now, behind the counter, waits for the next cycle. */
static inline void find_next(pwm_submodule_t *s, uint64_t now)
{
    if (!s->running || s->stuck) {
        s->next_clock = CHIP_NEVER;
        return;
    }
    if (s->order != PWM_ORDER_KEPT) {
        sort_events(s);
        s->next = 0;
        while ((int64_t)PWM_EVENT_DISTANCE(s->event[s->next]) <= s->done || clock_of(s, s->event[s->next]) < now) {
            s->next++;
        }
    }
    s->next_clock = clock_of(s, s->event[s->next]);
}

static inline void find_due(pwm_t *pwm, unsigned n)
{
    const pwm_submodule_t *s = &pwm->sub[n];
    const uint64_t due = (s->dead_clock < s->next_clock) ? s->dead_clock : s->next_clock;
    pwm->due[n] = (s->sync_clock < due) ? s->sync_clock : due;
}

static inline void schedule_module(chip_t *chip, unsigned m)
{
    pwm_t *pwm = &chip->pwm[m];
    const uint64_t *due = pwm->due;
    const unsigned a = (due[1] < due[0]) ? 1u : 0u;
    const unsigned b = (due[3] < due[2]) ? 3u : 2u;
    pwm->first = (due[b] < due[a]) ? b : a;
    chip_schedule_pwm(chip, m, due[pwm->first]);
}

void pwm_schedule(chip_t *chip, unsigned m, unsigned n)
{
    find_next(sub_of(chip, m, n), chip->now);
    find_due(&chip->pwm[m], n);
    schedule_module(chip, m);
}

static void run(chip_t *chip, unsigned m, unsigned n);

/* ---- interrupts ---------------------------------------------------------------------------------------------------- */

static const uint8_t compare_vector[PWM_MODULES][PWM_SUBMODULES] = {{87, 85, 83, 81}, {76, 73, 70, 67}};
static const uint8_t reload_vector[PWM_MODULES][PWM_SUBMODULES] = {{86, 84, 82, 79}, {74, 71, 68, 65}};

void pwm_request(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    if ((s->inten & STS_CMPF) != 0) {
        pwm_settle(chip, s);
    }
    intc_request(chip, compare_vector[m][n], (s->flags & s->inten & STS_CMPF) != 0);
    intc_request(chip, reload_vector[m][n], (s->flags & s->inten & STS_RF) != 0);
    bool error = false;
    for (unsigned i = 0; i < PWM_SUBMODULES; i++) {
        error = error || (chip->pwm[m].sub[i].flags & chip->pwm[m].sub[i].inten & STS_REF) != 0;
    }
    intc_request(chip, (m == 0) ? VECTOR_PWMA_RERR : VECTOR_PWMB_RERR, error);
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

void pwm_load(chip_t *chip, unsigned m, unsigned n)
{
    pwm_t *pwm = &chip->pwm[m];
    pwm_submodule_t *s = &pwm->sub[n];
    pwm_settle(chip, s);
    if (s->buffer.prescaler != s->active.prescaler && s->running) {
        s->base = pwm_counter(s, chip->now);
        s->origin = chip->now;
        s->done = s->settled = 0;
    }
    s->active = s->buffer;
    s->updated = false;
    pwm->ldok = (uint16_t)(pwm->ldok & ~(1u << n));
    find_distances(s);
    s->stuck = s->running && never_counts(s) && s->base == s->active.init;
    chip_note(chip, TRACE_LOAD, m * PWM_SUBMODULES + n, 0);
}

/* A reload point of submodule n: counts for LDFQ, then loads what is ready in it and in those that follow it. */
static void reload(chip_t *chip, unsigned m, unsigned n, bool at_end)
{
    pwm_t *pwm = &chip->pwm[m];
    pwm_submodule_t *s = &pwm->sub[n];
    if (++s->opportunities <= CTRL_LDFQ(s->ctrl)) {
        return;
    }
    s->opportunities = 0;
    for (unsigned k = n; k < PWM_SUBMODULES; k++) {
        pwm_submodule_t *other = &pwm->sub[k];
        const bool follows = k == n || (n == 0 && (other->ctrl2 & CTRL2_RELOAD_SEL) != 0);
        if (!follows || !other->running) {
            continue;
        }
        other->flags = (uint16_t)(other->flags | STS_RF);
        if (((pwm->ldok >> k) & 1u) != 0) {
            if (k != n && !at_end) { /* its matches of this clock see the old values */
                if (pwm->due[k] <= chip->now) {
                    run(chip, m, k);
                }
                const int64_t here = position(other, chip->now);
                other->done = (here > other->done) ? here : other->done;
            }
            pwm_load(chip, m, k);
        } else if (other->updated) {
            other->flags = (uint16_t)(other->flags | STS_REF);
        }
        if (CTRL2_FORCE_SEL(other->ctrl2) == FORCE_RELOAD) {
            pwm_force_out(chip, m, k);
        }
        if ((other->inten & (STS_RF | STS_REF)) != 0) {
            pwm_request(chip, m, k);
        }
        if (k != n) {
            find_next(other, chip->now);
            find_due(pwm, k);
        }
    }
}

/* The counter begins anew from INIT in the present clock. */
void pwm_begin_cycle(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    s->origin = chip->now;
    s->done = s->settled = -1;
    s->next = 0;
    if (s->base != s->active.init) {
        s->base = s->active.init;
        find_distances(s);
    }
    s->stuck = never_counts(s);
    chip_note(chip, TRACE_CYCLE, m * PWM_SUBMODULES + n, s->base);
    pwm_resume(chip, m, n, chip->pwm[m].fsts_full);
}

/* One past VAL1: the submodule's own sync. */
static void local_sync(chip_t *chip, unsigned m, unsigned n)
{
    pwm_t *pwm = &chip->pwm[m];
    pwm_submodule_t *s = &pwm->sub[n];
    settle_to(s, (int64_t)s->distance[PWM_CYCLE] - 1);
    s->done = s->distance[PWM_CYCLE];
    const bool own_reload = n == 0 || (s->ctrl2 & CTRL2_RELOAD_SEL) == 0;
    if ((s->ctrl & CTRL_FULL) != 0 && own_reload) {
        reload(chip, m, n, true);
    }
    if (CTRL2_INIT_SEL(s->ctrl2) == INIT_LOCAL) {
        pwm_begin_cycle(chip, m, n);
    }
    if (CTRL2_FORCE_SEL(s->ctrl2) == FORCE_SYNC) {
        pwm_force_out(chip, m, n);
    }
    for (unsigned k = 1; n == 0 && k < PWM_SUBMODULES; k++) {
        pwm_submodule_t *other = &pwm->sub[k];
        if (!other->running) {
            continue;
        }
        if (CTRL2_INIT_SEL(other->ctrl2) == INIT_MASTER_SYNC) {
            if (position(other, chip->now) > 0) {
                settle_to(other, position(other, chip->now) - 1);
            }
            pwm_begin_cycle(chip, m, k);
        }
        if (CTRL2_FORCE_SEL(other->ctrl2) == FORCE_MASTER_SYNC) {
            pwm_force_out(chip, m, k);
        }
        find_next(other, chip->now);
        find_due(pwm, k);
        if (pwm->due[k] <= chip->now) {
            run(chip, m, k);
        }
    }
}

static void trigger(chip_t *chip, unsigned m, unsigned n, unsigned odd)
{
    int a = (m == 0) ? (int)(20u + 2u * n + odd) : (n < 3u) ? (int)(40u + n) : (int)(43u + odd);
    const int b = (m == 0) ? (int)(8u + n) : (int)(22u + n);
    chip_note(chip, TRACE_TRIGGER, (uint32_t)a, 0);
    xbar_signal(chip, a, b, XBAR_PULSE);
}

/* Watched compares at the distance d, in the present clock. */
static void matches(chip_t *chip, unsigned m, unsigned n, uint32_t d, unsigned hit)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    s->done = d;
    if ((hit & 0x3Cu) != 0) { /* equal edges: off */
        const unsigned on = ((hit & 0x04u) != 0 ? 1u : 0u) | ((hit & 0x10u) != 0 ? 2u : 0u);
        const unsigned off = ((hit & 0x08u) != 0 ? 1u : 0u) | ((hit & 0x20u) != 0 ? 2u : 0u);
        s->generated = (s->generated | on) & ~off;
        pwm_drive(chip, m, n);
    }
    const unsigned noted = hit & (s->tctrl | s->inten) & 0x3Fu;
    if (noted != 0) {
        for (unsigned k = 0; k < PWM_VALS; k++) {
            if (((noted >> k) & 1u) != 0) {
                chip_note(chip, TRACE_MATCH, m * PWM_SUBMODULES + n, k);
            }
        }
        if ((noted & s->inten) != 0) {
            pwm_request(chip, m, n);
        }
        const unsigned triggers = hit & s->tctrl & 0x3Fu;
        if ((triggers & 0x15u) != 0) {
            trigger(chip, m, n, 0);
        }
        if ((triggers & 0x2Au) != 0) {
            trigger(chip, m, n, 1);
        }
    }
    if ((hit & 1u) != 0) {
        pwm_resume(chip, m, n, chip->pwm[m].fsts_half);
        if ((s->ctrl & CTRL_HALF) != 0 && (n == 0 || (s->ctrl2 & CTRL2_RELOAD_SEL) == 0)) {
            reload(chip, m, n, false);
        }
    }
}

/* The counter's next events, all that share a distance. */
static void handle(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    const uint32_t d = PWM_EVENT_DISTANCE(s->event[s->next]);
    unsigned what = 0;
    do {
        what |= BIT(PWM_EVENT_NUMBER(s->event[s->next++]));
    } while (PWM_EVENT_DISTANCE(s->event[s->next]) == d);
    if ((what & BIT(PWM_CYCLE)) != 0) {
        local_sync(chip, m, n);
        if (s->done != (int64_t)d) {
            return; /* a new cycle */
        }
    }
    if ((what & BIT(PWM_WRAP)) != 0) {
        settle_to(s, (int64_t)WRAP_DISTANCE - 1);
        s->origin += (uint64_t)WRAP_DISTANCE << s->active.prescaler;
        s->done = s->settled = -1;
        s->next = 0;
    } else if ((what & STS_CMPF) != 0) {
        matches(chip, m, n, d, what & STS_CMPF); /* unless it ends a cycle VAL1 + 1 is a count like any other */
    }
}

/* All events of a submodule up to the present clock. */
static void run(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    const bool synchronised = s->running && s->sync_clock <= chip->now;
    if (synchronised) {
        s->sync_clock = CHIP_NEVER;
        if (CTRL2_INIT_SEL(s->ctrl2) == INIT_EXT_SYNC) {
            const int64_t before = position(s, chip->now) - 1;
            const int64_t end = s->distance[PWM_CYCLE];
            settle_to(s, before);
            if (end > s->done && end <= before + 1) {
                local_sync(chip, m, n); /* its VAL1 was the count before */
            }
            pwm_begin_cycle(chip, m, n);
        }
    }
    if (s->next_clock <= chip->now || synchronised) {
        find_next(s, chip->now);
        while (s->next_clock <= chip->now) {
            handle(chip, m, n);
            find_next(s, chip->now);
        }
    }
    if (s->dead_clock <= chip->now) {
        pwm_end_dead_time(chip, m, n);
    }
    find_due(&chip->pwm[m], n);
}

/* Most events are an edge of PWM23 or the end of a dead time, and nothing else: these go the short way. */
static inline void edge_or_run(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    const uint64_t now = chip->now;
    if (s->next_clock > now && s->sync_clock > now) {
        pwm_end_dead_time(chip, m, n);
        find_due(&chip->pwm[m], n);
        return;
    }
    const uint32_t event = s->event[s->next];
    const uint32_t after = s->event[s->next + 1u];
    const bool alone = s->next_clock <= now && s->sync_clock > now && s->dead_clock > now;
    const bool edge = (s->plain & BIT(PWM_EVENT_NUMBER(event))) != 0 &&
                      PWM_EVENT_DISTANCE(after) != PWM_EVENT_DISTANCE(event) && s->order == PWM_ORDER_KEPT;
    if (!alone || !edge) {
        run(chip, m, n);
        return;
    }
    s->done = PWM_EVENT_DISTANCE(event);
    s->next++;
    s->next_clock = clock_of(s, after);
    s->generated = (s->generated & ~1u) | (PWM_EVENT_NUMBER(event) == 2u ? 1u : 0u); /* VAL2 on, VAL3 off */
    pwm_drive(chip, m, n);
    find_due(&chip->pwm[m], n);
}

void pwm_event(chip_t *chip, unsigned m)
{
    const pwm_t *pwm = &chip->pwm[m];
    do {
        edge_or_run(chip, m, pwm->first);
        schedule_module(chip, m);
    } while (pwm->due[pwm->first] <= chip->now);
}

void pwm_ext_sync(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    if (s->running) {
        s->sync_clock = chip->now + chip->config.crossbar_clocks + 1u;
        pwm_schedule(chip, m, n);
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
        const bool run = clocked && ((pwm->run >> n) & (shared ? pwm->run : 1u) & 1u) != 0;
        if (run == s->running) {
            continue;
        }
        if (run) {
            occs_need_bus_clock(chip, "a PWM");
            if (((pwm->ldok >> n) & 1u) != 0) {
                pwm_load(chip, m, n);
            }
            s->running = true;
            pwm_begin_cycle(chip, m, n);
        } else {
            pwm_settle(chip, s);
            s->base = clocked ? s->active.init : pwm_counter(s, chip->now);
            s->running = false;
            s->sync_clock = CHIP_NEVER;
        }
        pwm_schedule(chip, m, n);
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
                .ctrl = CTRL_FULL,
                .dismap0 = 0xFFFF,
                .dismap1 = 0xFFFF,
                .dtcnt = {0x7FF, 0x7FF},
                .sync_clock = CHIP_NEVER,
                .dead_clock = CHIP_NEVER,
                .next_clock = CHIP_NEVER,
                .out = 2u,
                .order = PWM_ORDER_STALE,
                .done = -1,
                .settled = -1,
                .levels = levels[n],
            };
            pwm->due[n] = CHIP_NEVER;
            find_distances(s);
            pwm_watch(pwm, n);
        }
        for (unsigned i = 0; i < PWM_FAULTS; i++) {
            pwm->fault_clock[i] = CHIP_NEVER;
        }
        pwm_find_faults(chip, m); /* low is a fault until software says otherwise */
    }
}
