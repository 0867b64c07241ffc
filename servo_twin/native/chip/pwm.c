#include "chip/pwm_parts.h"

#define NO_DISTANCE UINT32_C(0x10000)

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
    s->cycle = s->distance[1] + 1u;
    s->moved = true;
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
    s->stale = s->stale || watched != s->watched;
    s->watched = watched;
    const bool simple = (s->ctrl2 & CTRL2_INDEP) == 0 && ((pwm->ipol >> n) & 1u) == 0;
    s->plain = simple ? 0x0Cu & ~(unsigned)(s->tctrl | s->inten) : 0u;
}

/* Put the events of a cycle in order. */
static void sort_events(pwm_submodule_t *s)
{
    unsigned count = 0;
    s->merged = false;
    s->event[count].distance = NO_DISTANCE;
    s->event[count].first = PWM_VALS + 1u;
    s->event[count++].what = PWM_WRAP;
    for (unsigned k = 0; k <= PWM_VALS; k++) {
        const bool end = k == PWM_VALS;
        if (!end && ((s->watched >> k) & 1u) == 0) {
            continue;
        }
        const uint32_t d = end ? s->cycle : s->distance[k];
        const uint8_t what = (uint8_t)(end ? PWM_CYCLE : 1u << k);
        unsigned at = count;
        while (at > 0 && s->event[at - 1u].distance > d) {
            at--;
        }
        if (at > 0 && s->event[at - 1u].distance == d) {
            s->event[at - 1u].what = (uint8_t)(s->event[at - 1u].what | what);
            s->merged = true;
            continue;
        }
        for (unsigned i = count; i > at; i--) {
            s->event[i] = s->event[i - 1u];
        }
        s->event[at].distance = d;
        s->event[at].first = (uint8_t)k;
        s->event[at].what = what;
        count++;
    }
    s->stale = s->moved = false;
}

/* The same events at other distances: usually their order has stayed. */
static void move_events(pwm_submodule_t *s)
{
    uint32_t before = 0;
    for (unsigned i = 0; !s->merged && s->event[i].what != PWM_WRAP; i++) {
        const unsigned k = s->event[i].first;
        const uint32_t d = (k < PWM_VALS) ? s->distance[k] : s->cycle;
        if (d < before) {
            sort_events(s);
            return;
        }
        s->event[i].distance = d;
        before = d + 1u;
    }
    if (s->merged || before > NO_DISTANCE) {
        sort_events(s);
    }
    s->moved = false;
}

/* When the counter's next event is. What has become one only now, behind the counter, waits for the next cycle. */
static void find_next(pwm_submodule_t *s, uint64_t now)
{
    if (!s->running || s->stuck) {
        s->next_clock = CHIP_NEVER;
        return;
    }
    if (s->stale || s->moved) {
        if (s->stale) {
            sort_events(s);
        } else {
            move_events(s);
        }
        s->next = 0;
        while ((int64_t)s->event[s->next].distance <= s->done ||
               s->origin + ((uint64_t)s->event[s->next].distance << s->active.prescaler) < now) {
            s->next++;
        }
    }
    s->next_clock = s->origin + ((uint64_t)s->event[s->next].distance << s->active.prescaler);
}

/* The event after the one that has just been handled. */
static inline void take_next(pwm_submodule_t *s, uint64_t now)
{
    if (s->stale || s->moved || s->stuck || !s->running) {
        find_next(s, now);
    } else {
        s->next_clock = s->origin + ((uint64_t)s->event[s->next].distance << s->active.prescaler);
    }
}

static inline void find_due(pwm_submodule_t *s)
{
    const uint64_t due = (s->dead_clock < s->next_clock) ? s->dead_clock : s->next_clock;
    s->due = (s->sync_clock < due) ? s->sync_clock : due;
}

static inline void schedule_module(chip_t *chip, unsigned m)
{
    const pwm_submodule_t *s = chip->pwm[m].sub;
    const uint64_t a = (s[1].due < s[0].due) ? s[1].due : s[0].due;
    const uint64_t b = (s[3].due < s[2].due) ? s[3].due : s[2].due;
    chip_schedule(chip, SOURCE_PWM + m, (b < a) ? b : a);
}

void pwm_schedule(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    find_next(s, chip->now);
    find_due(s);
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
                if (other->due <= chip->now) {
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
            find_due(other);
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
    settle_to(s, (int64_t)s->cycle - 1);
    s->done = s->cycle;
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
        find_due(other);
        if (other->due <= chip->now) {
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
        s->generated[0] = (hit & 0x08u) == 0 && (s->generated[0] || (hit & 0x04u) != 0);
        s->generated[1] = (hit & 0x20u) == 0 && (s->generated[1] || (hit & 0x10u) != 0);
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

/* The counter's next event. */
static void handle(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    const uint32_t d = s->event[s->next].distance;
    const unsigned what = s->event[s->next].what;
    s->next++;
    if ((what & PWM_CYCLE) != 0) {
        local_sync(chip, m, n);
        if (s->done != (int64_t)d) {
            return; /* a new cycle */
        }
    }
    if ((what & PWM_WRAP) != 0) {
        settle_to(s, (int64_t)NO_DISTANCE - 1);
        s->origin += (uint64_t)NO_DISTANCE << s->active.prescaler;
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
            settle_to(s, before);
            if ((int64_t)s->cycle > s->done && (int64_t)s->cycle <= before + 1) {
                local_sync(chip, m, n); /* its VAL1 was the count before */
            }
            pwm_begin_cycle(chip, m, n);
        }
    }
    if (s->next_clock <= chip->now || synchronised) {
        find_next(s, chip->now);
        while (s->next_clock <= chip->now) {
            handle(chip, m, n);
            take_next(s, chip->now);
        }
    }
    if (s->dead_clock <= chip->now) {
        pwm_end_dead_time(chip, m, n);
    }
    find_due(s);
}

/* Most events are an edge of PWM23 or the end of a dead time, and nothing else: these go the short way. */
static inline void edge_or_run(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    const uint64_t now = chip->now;
    if (s->sync_clock <= now) {
        run(chip, m, n);
        return;
    }
    if (s->next_clock <= now) {
        const unsigned what = s->event[s->next].what;
        if ((what & ~s->plain) != 0 || s->stale || s->moved || s->dead_clock <= now) {
            run(chip, m, n);
            return;
        }
        s->done = s->event[s->next++].distance;
        s->generated[0] = what == 0x04u; /* VAL2 alone; with VAL3 it is off */
        s->next_clock = s->origin + ((uint64_t)s->event[s->next].distance << s->active.prescaler);
        pwm_drive(chip, m, n);
    } else {
        pwm_end_dead_time(chip, m, n);
    }
    find_due(s);
}

void pwm_event(chip_t *chip, unsigned m)
{
    const pwm_t *pwm = &chip->pwm[m];
    const uint64_t now = chip->now;
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        if (pwm->sub[n].due <= now) {
            edge_or_run(chip, m, n);
        }
    }
    schedule_module(chip, m);
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
                .due = CHIP_NEVER,
                .out = {false, true},
                .done = -1,
                .settled = -1,
                .levels = levels[n],
            };
            find_distances(s);
            pwm_watch(pwm, n);
        }
        for (unsigned i = 0; i < PWM_FAULTS; i++) {
            pwm->fault_clock[i] = CHIP_NEVER;
        }
        pwm_find_faults(chip, m); /* low is a fault until software says otherwise */
    }
}
