#include "chip/pwm.h"

#include "chip/parts.h"

#define MODULE_SIZE 0x100u
#define BASE 0xE600u
#define SUB_SIZE 0x30u
#define SUB_REGISTERS (PWM_SUBMODULES * SUB_SIZE)

/* Registers of a submodule. */
enum {
    CNT = 0x00,
    INIT = 0x01,
    CTRL2 = 0x02,
    CTRL = 0x03,
    VAL0 = 0x05,
    FRACVAL1 = 0x06,
    VAL5 = 0x0F,
    FRCTRL = 0x10,
    OCTRL = 0x11,
    STS = 0x12,
    INTEN = 0x13,
    DMAEN = 0x14,
    TCTRL = 0x15,
    DISMAP0 = 0x16,
    DISMAP1 = 0x17,
    DTCNT0 = 0x18,
    DTCNT1 = 0x19
};

/* Registers of a module. */
enum {
    OUTEN = 0xC0,
    MASK = 0xC1,
    SWCOUT = 0xC2,
    DTSRCSEL = 0xC3,
    MCTRL = 0xC4,
    MCTRL2 = 0xC5,
    FCTRL0 = 0xC6,
    FSTS0 = 0xC7,
    FFILT0 = 0xC8,
    FTST0 = 0xC9,
    FCTRL1 = 0xCA,
    FSTS1 = 0xCB,
    FFILT1 = 0xCC,
    FTST1 = 0xCD
};

#define CTRL2_CLK_SEL(x) ((x) & 3u)
#define CTRL2_RELOAD_SEL 0x0004u
#define CTRL2_FORCE_SEL(x) (((x) >> 3) & 7u)
#define CTRL2_FORCE 0x0040u
#define CTRL2_FRCEN 0x0080u
#define CTRL2_INIT_SEL(x) (((x) >> 8) & 3u)
#define CTRL2_PWM45_INIT 0x0800u
#define CTRL2_PWM23_INIT 0x1000u
#define CTRL2_INDEP 0x2000u
enum { INIT_LOCAL, INIT_MASTER_RELOAD, INIT_MASTER_SYNC, INIT_EXT_SYNC };
enum { FORCE_LOCAL, FORCE_MASTER, FORCE_RELOAD, FORCE_MASTER_RELOAD, FORCE_SYNC, FORCE_MASTER_SYNC };

#define CTRL_LDMOD 0x0004u
#define CTRL_PRSC(x) (((x) >> 4) & 7u)
#define CTRL_FULL 0x0400u
#define CTRL_HALF 0x0800u
#define CTRL_LDFQ(x) ((unsigned)(x) >> 12)

#define STS_RF 0x1000u
#define STS_REF 0x2000u
#define STS_RUF 0x4000u
#define STS_CMPF 0x003Fu

#define OCTRL_PWMBFS(x) (((x) >> 2) & 3u)
#define OCTRL_PWMAFS(x) (((x) >> 4) & 3u)
#define OCTRL_POLB 0x0200u
#define OCTRL_POLA 0x0400u

#define FCTRL_FSAFE(x, i) ((((x) >> 4) >> (i)) & 1u)
#define FCTRL_FAUTO(x, i) ((((x) >> 8) >> (i)) & 1u)
#define FCTRL_FLVL(x) (((x) >> 12) & 0xFu)

#define NO_DISTANCE UINT32_C(0x10000)

static pwm_submodule_t *sub_of(chip_t *chip, unsigned m, unsigned n) { return &chip->pwm[m].sub[n]; }

/* ---- counter ------------------------------------------------------------------------------------------------------- */

static uint32_t distance_of(const pwm_submodule_t *s, uint16_t count) { return (uint16_t)(count - s->base); }

static int64_t position(const pwm_submodule_t *s, uint64_t now)
{
    return (int64_t)((now - s->origin) >> s->active.prescaler);
}

static uint16_t counter(const pwm_submodule_t *s, uint64_t now)
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

static void settle(const chip_t *chip, pwm_submodule_t *s)
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
static void watch(pwm_t *pwm, unsigned n)
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

/* When the counter's next event is. */
static void find_next(pwm_submodule_t *s)
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
        while ((int64_t)s->event[s->next].distance <= s->done) {
            s->next++;
        }
    }
    s->next_clock = s->origin + ((uint64_t)s->event[s->next].distance << s->active.prescaler);
}

/* The event after the one that has just been handled. */
static inline void take_next(pwm_submodule_t *s)
{
    if (s->stale || s->moved || s->stuck || !s->running) {
        find_next(s);
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

static void schedule(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    find_next(s);
    find_due(s);
    schedule_module(chip, m);
}

static void run(chip_t *chip, unsigned m, unsigned n);

/* ---- interrupts ---------------------------------------------------------------------------------------------------- */

static const uint8_t compare_vector[PWM_MODULES][PWM_SUBMODULES] = {{87, 85, 83, 81}, {76, 73, 70, 67}};
static const uint8_t reload_vector[PWM_MODULES][PWM_SUBMODULES] = {{86, 84, 82, 79}, {74, 71, 68, 65}};

static void request(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    if ((s->inten & STS_CMPF) != 0) {
        settle(chip, s);
    }
    intc_request(chip, compare_vector[m][n], (s->flags & s->inten & STS_CMPF) != 0);
    intc_request(chip, reload_vector[m][n], (s->flags & s->inten & STS_RF) != 0);
    bool error = false;
    for (unsigned i = 0; i < PWM_SUBMODULES; i++) {
        error = error || (chip->pwm[m].sub[i].flags & chip->pwm[m].sub[i].inten & STS_REF) != 0;
    }
    intc_request(chip, (m == 0) ? VECTOR_PWMA_RERR : VECTOR_PWMB_RERR, error);
}

static void request_fault(chip_t *chip, unsigned m)
{
    const pwm_t *pwm = &chip->pwm[m];
    intc_request(chip, (m == 0) ? VECTOR_PWMA_FAULT : VECTOR_PWMB_FAULT, (pwm->fault_flag & pwm->fctrl & 0xFu) != 0);
}

/* ---- outputs ------------------------------------------------------------------------------------------------------- */

/* Which pins of a pair follow its outputs. One that nobody drives is held low by the resistor of its gate driver. */
static void prepare(chip_t *chip, unsigned m, unsigned n)
{
    const pwm_t *pwm = &chip->pwm[m];
    pwm_submodule_t *s = sub_of(chip, m, n);
    s->live = s->high = s->inverted = 0;
    for (unsigned side = 0; n < 3u && side < 2u; side++) {
        const unsigned pin = chip->config.wiring.gate[m][n][side];
        const pin_function_t function = pins_function(chip, pin);
        const unsigned bit = 1u << side;
        const unsigned map = (side == 0) ? s->dismap0 : (unsigned)s->dismap0 >> 4;
        const unsigned on_fault = (side == 0) ? OCTRL_PWMAFS(s->octrl) : OCTRL_PWMBFS(s->octrl);
        if (function == FUNCTION_GPIO) {
            const gpio_port_t *port = &chip->pins.port[pin >> 4];
            s->high |= (((unsigned)(port->direction & port->data) >> (pin & 15u)) & 1u) << side;
        } else if (function != (pin_function_t)(FUNCTION_PWM_A0A + 8u * m + 2u * n + side) ||
                   ((pwm->outen >> (((side == 0) ? 8u : 4u) + n)) & 1u) == 0) {
            continue;
        } else if ((s->blocked & map & 0xFu) != 0) {
            s->high |= (on_fault == 1u) ? bit : 0u;
        } else {
            s->live |= bit;
            s->inverted |= ((s->octrl & ((side == 0) ? OCTRL_POLA : OCTRL_POLB)) != 0) ? bit : 0u;
        }
    }
}

static void show(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    const unsigned out = ((s->out[0] ? 1u : 0u) | (s->out[1] ? 2u : 0u)) & ~s->mask;
    const unsigned levels = ((out ^ s->inverted) & s->live) | s->high;
    if (levels != s->levels) {
        s->levels = levels;
        chip_note(chip, TRACE_GATES, m * PWM_SUBMODULES + n, levels);
        chip_meet_world(chip);
        chip->touched = true;
        chip->world.gates(chip->world.context, m, n, levels);
    }
}

static void show_all(chip_t *chip, unsigned m)
{
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        prepare(chip, m, n);
        show(chip, m, n);
    }
}

void pwm_pins_changed(chip_t *chip)
{
    show_all(chip, 0);
    show_all(chip, 1);
}

/* What DTSRCSEL takes: 0 generated, 1 inverted, 2 software. */
static bool selected(const pwm_submodule_t *s, unsigned which)
{
    switch (s->source[which]) {
    case 0:
        return s->generated[which];
    case 1:
        return !s->generated[which];
    default:
        return s->software[which];
    }
}

/* The dead-time unit: the switch that closes waits for its count, the other opens at once. */
static void drive(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    if ((s->ctrl2 & CTRL2_INDEP) != 0) {
        s->out[0] = selected(s, 0);
        s->out[1] = selected(s, 1);
        s->dead_clock = CHIP_NEVER;
    } else {
        const bool from_45 = ((chip->pwm[m].ipol >> n) & 1u) != 0;
        const bool pair = from_45 ? !selected(s, 1) : selected(s, 0);
        if (pair != s->pair || (!s->out[0] && !s->out[1] && s->dead_clock == CHIP_NEVER)) {
            s->pair = pair;
            s->out[pair ? 1 : 0] = false;
            const unsigned dead = s->dtcnt[pair ? 0 : 1];
            s->out[pair ? 0 : 1] = dead == 0;
            s->dead_clock = (dead == 0) ? CHIP_NEVER : chip->now + dead;
        }
    }
    show(chip, m, n);
}

static void end_dead_time(chip_t *chip, unsigned m, unsigned n)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    s->dead_clock = CHIP_NEVER;
    s->out[s->pair ? 0 : 1] = true;
    show(chip, m, n);
}

static void force_out(chip_t *chip, unsigned m, unsigned n)
{
    pwm_t *pwm = &chip->pwm[m];
    pwm_submodule_t *s = &pwm->sub[n];
    s->source[0] = (pwm->dtsrcsel >> (4u * n + 2u)) & 3u;
    s->source[1] = (pwm->dtsrcsel >> (4u * n)) & 3u;
    s->software[0] = ((pwm->swcout >> (2u * n + 1u)) & 1u) != 0;
    s->software[1] = ((pwm->swcout >> (2u * n)) & 1u) != 0;
    s->mask = ((pwm->mask >> (8u + n)) & 1u) | (((pwm->mask >> (4u + n)) & 1u) << 1);
    drive(chip, m, n);
}

/* ---- faults ---------------------------------------------------------------------------------------------------------- */

static bool may_resume(const pwm_t *pwm, unsigned i)
{
    const bool active = ((pwm->fault_active >> i) & 1u) != 0;
    if (FCTRL_FAUTO(pwm->fctrl, i) != 0) {
        return !active;
    }
    const bool flag = ((pwm->fault_flag >> i) & 1u) != 0;
    return !flag && !(FCTRL_FSAFE(pwm->fctrl, i) != 0 && active);
}

/* The cycle (or half of it) begins: outputs resume that were waiting for it. */
static void resume(chip_t *chip, unsigned m, unsigned n, uint16_t boundary)
{
    pwm_t *pwm = &chip->pwm[m];
    pwm_submodule_t *s = &pwm->sub[n];
    if (s->blocked == 0) {
        return;
    }
    const unsigned before = s->blocked;
    for (unsigned i = 0; (s->blocked & boundary) != 0 && i < PWM_FAULTS; i++) {
        if (((s->blocked & boundary) >> i & 1u) != 0 && may_resume(pwm, i)) {
            s->blocked &= ~(1u << i);
        }
    }
    if (s->blocked != before) {
        watch(pwm, n);
        prepare(chip, m, n);
        show(chip, m, n);
    }
}

static void find_faults(chip_t *chip, unsigned m)
{
    pwm_t *pwm = &chip->pwm[m];
    const unsigned simulated = ((pwm->ftst & 1u) != 0) ? 0xFu : 0u;
    const unsigned active = ((pwm->fault_filtered ^ ~FCTRL_FLVL(pwm->fctrl)) & 0xFu) | simulated;
    const unsigned begun = active & ~pwm->fault_active;
    pwm->fault_active = active;
    if (begun == 0) {
        return;
    }
    pwm->fault_flag |= begun;
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        pwm->sub[n].blocked |= begun;
        watch(pwm, n);
        prepare(chip, m, n);
        show(chip, m, n);
        schedule(chip, m, n);
    }
    request_fault(chip, m);
}

static void schedule_fault(chip_t *chip)
{
    uint64_t next = CHIP_NEVER;
    for (unsigned i = 0; i < PWM_MODULES * PWM_FAULTS; i++) {
        const uint64_t clock = chip->pwm[i / PWM_FAULTS].fault_clock[i % PWM_FAULTS];
        next = (clock < next) ? clock : next;
    }
    chip_schedule(chip, SOURCE_FAULT, next);
}

void pwm_fault_event(chip_t *chip)
{
    for (unsigned m = 0; m < PWM_MODULES; m++) {
        pwm_t *pwm = &chip->pwm[m];
        for (unsigned i = 0; i < PWM_FAULTS; i++) {
            if (pwm->fault_clock[i] <= chip->now) {
                pwm->fault_clock[i] = CHIP_NEVER;
                pwm->fault_filtered ^= 1u << i;
            }
        }
        find_faults(chip, m);
    }
    schedule_fault(chip);
}

void pwm_fault_input(chip_t *chip, unsigned m, unsigned input, bool level)
{
    pwm_t *pwm = &chip->pwm[m];
    const unsigned bit = 1u << input;
    if (((pwm->fault_pin & bit) != 0) == level) {
        return;
    }
    pwm->fault_pin ^= bit;
    const uint64_t delay = (uint64_t)(pwm->ffilt & 0xFFu) * (((unsigned)pwm->ffilt >> 8 & 7u) + 3u);
    const bool same = ((pwm->fault_filtered & bit) != 0) == level;
    pwm->fault_clock[input] = same ? CHIP_NEVER : chip->now + delay;
    schedule_fault(chip);
    if (!same && delay == 0) {
        pwm_fault_event(chip);
    }
}

/* ---- loading and cycles ---------------------------------------------------------------------------------------------- */

/* A cycle of one clock. */
static bool never_counts(const pwm_submodule_t *s)
{
    return CTRL2_INIT_SEL(s->ctrl2) == INIT_LOCAL && s->active.val[1] == s->active.init;
}

static void load(chip_t *chip, unsigned m, unsigned n)
{
    pwm_t *pwm = &chip->pwm[m];
    pwm_submodule_t *s = &pwm->sub[n];
    settle(chip, s);
    if (s->buffer.prescaler != s->active.prescaler && s->running) {
        s->base = counter(s, chip->now);
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
            if (k != n && !at_end && other->due <= chip->now) {
                run(chip, m, k); /* its matches of this clock see the old values */
            }
            load(chip, m, k);
        } else if (other->updated) {
            other->flags = (uint16_t)(other->flags | STS_REF);
        }
        if (CTRL2_FORCE_SEL(other->ctrl2) == FORCE_RELOAD) {
            force_out(chip, m, k);
        }
        if ((other->inten & (STS_RF | STS_REF)) != 0) {
            request(chip, m, k);
        }
        if (k != n) {
            find_next(other);
            find_due(other);
        }
    }
}

/* The counter begins anew from INIT in the present clock. */
static void begin_cycle(chip_t *chip, unsigned m, unsigned n)
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
    resume(chip, m, n, chip->pwm[m].fsts_full);
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
        begin_cycle(chip, m, n);
    }
    if (CTRL2_FORCE_SEL(s->ctrl2) == FORCE_SYNC) {
        force_out(chip, m, n);
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
            begin_cycle(chip, m, k);
        }
        if (CTRL2_FORCE_SEL(other->ctrl2) == FORCE_MASTER_SYNC) {
            force_out(chip, m, k);
        }
        find_next(other);
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
        drive(chip, m, n);
    }
    const unsigned noted = hit & (s->tctrl | s->inten) & 0x3Fu;
    if (noted != 0) {
        for (unsigned k = 0; k < PWM_VALS; k++) {
            if (((noted >> k) & 1u) != 0) {
                chip_note(chip, TRACE_MATCH, m * PWM_SUBMODULES + n, k);
            }
        }
        if ((noted & s->inten) != 0) {
            request(chip, m, n);
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
        resume(chip, m, n, chip->pwm[m].fsts_half);
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
            begin_cycle(chip, m, n);
        }
    }
    if (s->next_clock <= chip->now || synchronised) {
        find_next(s);
        while (s->next_clock <= chip->now) {
            handle(chip, m, n);
            take_next(s);
        }
    }
    if (s->dead_clock <= chip->now) {
        end_dead_time(chip, m, n);
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
        drive(chip, m, n);
    } else {
        end_dead_time(chip, m, n);
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
        schedule(chip, m, n);
    }
}

/* ---- start and stop ---------------------------------------------------------------------------------------------------- */

/* Submodule n counts while its RUN bit, or that of submodule 0 with whose clock it runs, and its gate are open. */
static void follow_run(chip_t *chip, unsigned m)
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
                load(chip, m, n);
            }
            s->running = true;
            begin_cycle(chip, m, n);
        } else {
            settle(chip, s);
            s->base = clocked ? s->active.init : counter(s, chip->now);
            s->running = false;
            s->sync_clock = CHIP_NEVER;
        }
        schedule(chip, m, n);
    }
}

void pwm_gates_changed(chip_t *chip)
{
    follow_run(chip, 0);
    follow_run(chip, 1);
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
            watch(pwm, n);
        }
        for (unsigned i = 0; i < PWM_FAULTS; i++) {
            pwm->fault_clock[i] = CHIP_NEVER;
        }
        find_faults(chip, m); /* low is a fault until software says otherwise */
    }
}

/* ---- registers ------------------------------------------------------------------------------------------------------- */

/* Buffered registers by their offset in the module: 10h + 8 submodule + (0 INIT, 1-6 VAL0-5); 1 is MCTRL. */
#define BUFFERED(n)                                                                                                    \
    [(n) * SUB_SIZE + INIT] = 0x10 + 8 * (n), [(n) * SUB_SIZE + VAL0] = 0x11 + 8 * (n),                                \
                      [(n) * SUB_SIZE + VAL0 + 2] = 0x12 + 8 * (n), [(n) * SUB_SIZE + VAL0 + 4] = 0x13 + 8 * (n),      \
                      [(n) * SUB_SIZE + VAL0 + 6] = 0x14 + 8 * (n), [(n) * SUB_SIZE + VAL0 + 8] = 0x15 + 8 * (n),      \
                      [(n) * SUB_SIZE + VAL5] = 0x16 + 8 * (n)

static const uint8_t buffered[MODULE_SIZE] = {BUFFERED(0), BUFFERED(1), BUFFERED(2), BUFFERED(3), [MCTRL] = 1};

bool pwm_buffers(uint32_t address) { return buffered[address & (MODULE_SIZE - 1u)] != 0; }

static bool is_value(uint32_t r) { return r == INIT || (r >= VAL0 && r <= VAL5 && (r & 1u) != 0); }

static bool is_fraction(uint32_t r) { return r >= FRACVAL1 && r < VAL5 && (r & 1u) == 0; }

static uint16_t read_sub(chip_t *chip, uint32_t address, unsigned m, unsigned n, uint32_t r)
{
    pwm_submodule_t *s = sub_of(chip, m, n);
    if (r == INIT) {
        return s->buffer.init;
    }
    if (is_value(r)) {
        return s->buffer.val[(r - VAL0) / 2u];
    }
    if (is_fraction(r)) {
        return 0;
    }
    switch (r) {
    case CNT:
        return counter(s, chip->now);
    case CTRL2:
        return s->ctrl2;
    case CTRL:
        return s->ctrl;
    case FRCTRL:
    case DMAEN:
        return 0;
    case OCTRL:
        return (uint16_t)(s->octrl | ((s->levels & 1u) << 15) | ((s->levels & 2u) << 13));
    case STS:
        settle(chip, s);
        return (uint16_t)(s->flags | (s->updated ? STS_RUF : 0u));
    case INTEN:
        return s->inten;
    case TCTRL:
        return s->tctrl;
    case DISMAP0:
        return s->dismap0;
    case DISMAP1:
        return s->dismap1;
    case DTCNT0:
    case DTCNT1:
        return s->dtcnt[r - DTCNT0];
    default:
        chip_no_register(chip, address);
    }
}

static void write_ctrl2(chip_t *chip, uint32_t address, unsigned m, unsigned n, uint16_t value)
{
    pwm_t *pwm = &chip->pwm[m];
    pwm_submodule_t *s = &pwm->sub[n];
    const unsigned clock = CTRL2_CLK_SEL(value);
    const unsigned force = CTRL2_FORCE_SEL(value);
    const unsigned init = CTRL2_INIT_SEL(value);
    if (clock == 1u || clock == 3u || (n == 0 && clock != 0)) {
        chip_no_value(chip, address, value, "this CLK_SEL is not modelled");
    }
    if (n == 0 && ((value & CTRL2_RELOAD_SEL) != 0 || init == INIT_MASTER_RELOAD || init == INIT_MASTER_SYNC)) {
        chip_no_value(chip, address, value, "submodule 0 cannot follow itself");
    }
    if (init == INIT_MASTER_RELOAD || force == FORCE_MASTER_RELOAD || force > FORCE_MASTER_SYNC ||
        (n == 0 && (force & 1u) != 0)) {
        chip_no_value(chip, address, value, "this INIT_SEL or FORCE_SEL is not modelled");
    }
    s->ctrl2 = (uint16_t)(value & ~CTRL2_FORCE);
    watch(pwm, n);
    follow_run(chip, m);
    if ((value & CTRL2_FORCE) != 0) {
        for (unsigned k = n; k < PWM_SUBMODULES; k++) {
            pwm_submodule_t *other = sub_of(chip, m, k);
            const unsigned by = CTRL2_FORCE_SEL(other->ctrl2);
            if ((k != n || by != FORCE_LOCAL) && !(n == 0 && k > 0 && by == FORCE_MASTER)) {
                continue;
            }
            if ((other->ctrl2 & CTRL2_FRCEN) != 0) {
                other->generated[0] = (other->ctrl2 & CTRL2_PWM23_INIT) != 0;
                other->generated[1] = (other->ctrl2 & CTRL2_PWM45_INIT) != 0;
                if (other->running) {
                    settle(chip, other);
                    begin_cycle(chip, m, k);
                }
            }
            force_out(chip, m, k);
            schedule(chip, m, k);
        }
    }
    schedule(chip, m, n);
}

static void write_sub(chip_t *chip, uint32_t address, unsigned m, unsigned n, uint32_t r, uint16_t value)
{
    pwm_t *pwm = &chip->pwm[m];
    pwm_submodule_t *s = &pwm->sub[n];
    if (is_fraction(r)) {
        chip_only(chip, address, value, 0, "the fractional unit is not modelled");
        return;
    }
    switch (r) {
    case CTRL2:
        write_ctrl2(chip, address, m, n, value);
        break;
    case CTRL:
        chip_only(chip, address, value, 0xFF74, "double switching is not modelled");
        s->ctrl = (uint16_t)(value & ~0x0300u);
        if (((pwm->ldok >> n) & 1u) == 0) {
            s->updated = s->updated || CTRL_PRSC(value) != s->buffer.prescaler;
            s->buffer.prescaler = CTRL_PRSC(value);
        }
        watch(pwm, n);
        schedule(chip, m, n);
        break;
    case FRCTRL:
        chip_only(chip, address, value, 0, "the fractional unit is not modelled");
        break;
    case OCTRL:
        s->octrl = value & 0x073Fu;
        prepare(chip, m, n);
        show(chip, m, n);
        break;
    case STS:
        settle(chip, s);
        s->flags = (uint16_t)(s->flags & ~value);
        request(chip, m, n);
        break;
    case INTEN:
        chip_only(chip, address, value, 0x303F, "the capture unit is not modelled");
        settle(chip, s);
        s->inten = value;
        watch(pwm, n);
        request(chip, m, n);
        schedule(chip, m, n);
        break;
    case DMAEN:
        chip_only(chip, address, value, 0, "DMA is not modelled");
        break;
    case TCTRL:
        chip_only(chip, address, value, 0x003F, "PWM waveforms as triggers are not modelled");
        s->tctrl = value;
        watch(pwm, n);
        schedule(chip, m, n);
        break;
    case DISMAP0:
        s->dismap0 = value;
        prepare(chip, m, n);
        show(chip, m, n);
        break;
    case DISMAP1: /* faults 4-7 have no pins here */
        s->dismap1 = value;
        break;
    case DTCNT0:
    case DTCNT1:
        s->dtcnt[r - DTCNT0] = value & 0x7FFu;
        break;
    default:
        chip_no_register(chip, address);
    }
}

static void write_mctrl(chip_t *chip, unsigned m, uint16_t value)
{
    pwm_t *pwm = &chip->pwm[m];
    pwm->ldok = (uint16_t)((pwm->ldok | (value & 0xFu)) & ~((unsigned)value >> 4 & 0xFu));
    const bool same_run = pwm->run == ((value >> 8) & 0xFu);
    const uint16_t ipol = (uint16_t)(value >> 12);
    if (ipol != pwm->ipol) {
        pwm->ipol = ipol;
        for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
            watch(pwm, n);
        }
    }
    pwm->run = (value >> 8) & 0xFu;
    const bool first_stuck = pwm->sub[0].running && pwm->sub[0].stuck;
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        pwm_submodule_t *s = &pwm->sub[n];
        /* A counter without a cycle meets its reload point, and that of its followers, in every clock. */
        const bool led = first_stuck && n > 0 && (s->ctrl2 & CTRL2_RELOAD_SEL) != 0;
        const bool stuck = s->running && (s->stuck || led);
        if (((pwm->ldok >> n) & 1u) != 0 && ((s->ctrl & CTRL_LDMOD) != 0 || stuck)) {
            load(chip, m, n);
            if (stuck) {
                begin_cycle(chip, m, n);
            }
            schedule(chip, m, n);
        }
    }
    if (!same_run) {
        follow_run(chip, m);
    }
}

static uint16_t fault_status(const pwm_t *pwm)
{
    return (uint16_t)(pwm->fault_flag | (unsigned)pwm->fsts_full << 4 | pwm->fault_filtered << 8 |
                      (unsigned)pwm->fsts_half << 12);
}

static uint16_t read_module(chip_t *chip, uint32_t address, unsigned m, uint32_t r)
{
    const pwm_t *pwm = &chip->pwm[m];
    switch (r) {
    case OUTEN:
        return pwm->outen;
    case MASK:
        return pwm->mask;
    case SWCOUT:
        return pwm->swcout;
    case DTSRCSEL:
        return pwm->dtsrcsel;
    case MCTRL:
        return (uint16_t)(pwm->ldok | (unsigned)pwm->run << 8 | (unsigned)pwm->ipol << 12);
    case MCTRL2:
        return pwm->mctrl2;
    case FCTRL0:
        return pwm->fctrl;
    case FSTS0:
        return fault_status(pwm);
    case FFILT0:
        return pwm->ffilt;
    case FTST0:
        return pwm->ftst;
    case FCTRL1:
        return pwm->fctrl1;
    case FSTS1:
        return pwm->fsts1;
    case FFILT1:
        return pwm->ffilt1;
    case FTST1:
        return pwm->ftst1;
    default:
        chip_no_register(chip, address);
    }
}

static void write_module(chip_t *chip, uint32_t address, unsigned m, uint32_t r, uint16_t value)
{
    pwm_t *pwm = &chip->pwm[m];
    switch (r) {
    case OUTEN:
        chip_only(chip, address, value, 0x0FF0, "PWM_X is not modelled");
        pwm->outen = value;
        show_all(chip, m);
        break;
    case MASK:
        pwm->mask = value & 0x0FFFu;
        break;
    case SWCOUT:
        pwm->swcout = value & 0x00FFu;
        break;
    case DTSRCSEL:
        for (unsigned k = 0; k < 8u; k++) {
            if (((value >> (2u * k)) & 3u) == 3u) {
                chip_no_value(chip, address, value, "external sources are not modelled");
            }
        }
        pwm->dtsrcsel = value;
        break;
    case MCTRL:
        write_mctrl(chip, m, value);
        break;
    case MCTRL2:
        chip_only(chip, address, value, 0x0003, "reserved");
        pwm->mctrl2 = value;
        break;
    case FCTRL0:
        pwm->fctrl = value;
        find_faults(chip, m);
        request_fault(chip, m);
        break;
    case FSTS0:
        pwm->fault_flag &= ~(unsigned)value;
        pwm->fsts_full = (value >> 4) & 0xFu;
        pwm->fsts_half = (uint16_t)(value >> 12);
        for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
            watch(pwm, n);
            schedule(chip, m, n);
        }
        request_fault(chip, m);
        break;
    case FFILT0:
        chip_only(chip, address, value, 0x87FF, "reserved");
        pwm->ffilt = value;
        break;
    case FTST0:
        pwm->ftst = value & 1u;
        find_faults(chip, m);
        break;
    case FCTRL1:
        chip_only(chip, address, value, 0xFFF0, "interrupts of the faults 4-7 are not modelled");
        pwm->fctrl1 = value;
        break;
    case FSTS1:
        pwm->fsts1 = value & 0xF0F0u;
        break;
    case FFILT1:
        pwm->ffilt1 = value;
        break;
    case FTST1:
        chip_only(chip, address, value, 0, "faults 4-7 are not modelled");
        break;
    default:
        chip_no_register(chip, address);
    }
}

static void check_gate(chip_t *chip, uint32_t address, unsigned m, uint32_t offset)
{
    const unsigned first = (m == 0) ? 7u : 3u;
    sim_gate(chip, address, 3, (offset < SUB_REGISTERS) ? first - offset / SUB_SIZE : first);
}

uint16_t pwm_read(chip_t *chip, uint32_t address)
{
    const unsigned m = (address - BASE) / MODULE_SIZE;
    const uint32_t offset = (address - BASE) % MODULE_SIZE;
    check_gate(chip, address, m, offset);
    if (offset < SUB_REGISTERS) {
        return read_sub(chip, address, m, offset / SUB_SIZE, offset % SUB_SIZE);
    }
    return read_module(chip, address, m, offset);
}

static void write_buffer(chip_t *chip, uint32_t address, unsigned m, unsigned what, uint16_t value)
{
    const unsigned n = (what >> 3) - 2u;
    pwm_t *pwm = &chip->pwm[m];
    sim_gate(chip, address, 3, ((m == 0) ? 7u : 3u) - n);
    if (((pwm->ldok >> n) & 1u) != 0) {
        pwm->locked_writes++;
        return;
    }
    pwm_submodule_t *s = &pwm->sub[n];
    if ((what & 7u) == 0) {
        s->buffer.init = value;
    } else {
        s->buffer.val[(what & 7u) - 1u] = value;
    }
    s->updated = true;
}

void pwm_write(chip_t *chip, uint32_t address, uint16_t value)
{
    const unsigned m = (address - BASE) / MODULE_SIZE;
    const uint32_t offset = (address - BASE) % MODULE_SIZE;
    if (buffered[offset] > 1u) {
        write_buffer(chip, address, m, buffered[offset], value);
        return;
    }
    check_gate(chip, address, m, offset);
    if (offset < SUB_REGISTERS) {
        write_sub(chip, address, m, offset / SUB_SIZE, offset % SUB_SIZE, value);
    } else {
        write_module(chip, address, m, offset, value);
    }
}
