#include "chip/qtmr.h"

#define MODULE_SIZE 0x40u

enum { COMP1, COMP2, CAPT, LOAD, HOLD, CNTR, CTRL, SCTRL, CMPLD1, CMPLD2, CSCTRL, FILT, DMA, ENBL = 0x0F };

#define CTRL_OUTMODE(x) ((x) & 7u)
#define CTRL_COINIT 0x0008u
#define CTRL_DIR 0x0010u
#define CTRL_LENGTH 0x0020u
#define CTRL_ONCE 0x0040u
#define CTRL_SCS(x) (((x) >> 7) & 3u)
#define CTRL_PCS(x) (((x) >> 9) & 0xFu)
#define CTRL_CM(x) (((unsigned)(x) >> 13) & 7u)
enum { CM_STOP, CM_RISING, CM_BOTH, CM_GATED, CM_QUADRATURE, CM_SIGNED, CM_TRIGGERED, CM_CASCADE };
enum { OUT_ACTIVE, OUT_CLEAR, OUT_SET, OUT_TOGGLE, OUT_ALTERNATE, OUT_SET_SECONDARY, OUT_SET_ROLLOVER, OUT_GATED };

#define SCTRL_FORCE 0x0004u
#define SCTRL_VAL 0x0008u
#define SCTRL_CAPTURE(x) (((x) >> 6) & 3u)
#define SCTRL_INPUT 0x0100u
#define SCTRL_IPS 0x0200u
#define SCTRL_IEFIE 0x0400u
#define SCTRL_IEF 0x0800u
#define SCTRL_TOFIE 0x1000u
#define SCTRL_TOF 0x2000u
#define SCTRL_TCFIE 0x4000u
#define SCTRL_TCF 0x8000u
#define SCTRL_FLAGS (SCTRL_IEF | SCTRL_TOF | SCTRL_TCF)

#define CSCTRL_TCF1 0x0010u
#define CSCTRL_TCF2 0x0020u
#define CSCTRL_TCF1EN 0x0040u
#define CSCTRL_TCF2EN 0x0080u
#define CSCTRL_UP 0x0200u
#define CSCTRL_ROC 0x0800u

#define FIRST_BUS_SOURCE 8u

/* Each channel of a mask, which is read once. */
#define FOR_EACH(n, mask)                                                                                              \
    for (unsigned remaining = (mask), n = 0; remaining != 0 && (n = lowest_bit(remaining), true);                      \
         remaining &= remaining - 1u)

static bool enabled(const qtmr_module_t *timer, unsigned n) { return ((timer->enable >> n) & 1u) != 0; }

static bool runs_on_bus(const qtmr_module_t *timer, unsigned n) { return ((timer->on_bus >> n) & 1u) != 0; }

static unsigned prescaler(const qtmr_channel_t *c) { return CTRL_PCS(c->reg[CTRL]) - FIRST_BUS_SOURCE; }

static bool counts_down(const qtmr_channel_t *c) { return (c->reg[CTRL] & CTRL_DIR) != 0; }

static void request(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n)
{
    const qtmr_channel_t *c = &timer->channel[n];
    const unsigned flags = c->reg[SCTRL] & (SCTRL_FLAGS);
    const unsigned enables = ((unsigned)c->reg[SCTRL] << 1) & SCTRL_FLAGS; /* each enable is one bit below its flag */
    const bool compare = (((unsigned)c->reg[CSCTRL] << 2) & c->reg[CSCTRL] & (CSCTRL_TCF1EN | CSCTRL_TCF2EN)) != 0;
    bus_request(qtmr->bus, ((timer->module == 0) ? VECTOR_TMRA0 : VECTOR_TMRB0) - n, (flags & enables) != 0 || compare);
}

/* ---- counting -------------------------------------------------------------------------------------------------------- */

static void count(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n, bool up);

NOINLINE static void change_oflag(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n, bool level)
{
    qtmr_channel_t *c = &timer->channel[n];
    c->oflag = level;
    const bool out = level != ((c->reg[SCTRL] & 2u) != 0); /* OPS inverts the output */
    qtmr->bus->signals->crossbar(qtmr->bus->chip, (int)((timer->module == 0) ? 36u + n : 16u + n),
                                 (int)((timer->module == 0) ? 16u + n : 4u + n), out ? XBAR_RISE : XBAR_FALL);
    FOR_EACH(k, timer->follows[n])
    {
        const unsigned mode = CTRL_CM(timer->channel[k].reg[CTRL]);
        if (level || mode == CM_BOTH) {
            count(qtmr, timer, k, !counts_down(&timer->channel[k]));
        }
    }
}

static inline void set_oflag(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n, bool level)
{
    if (timer->channel[n].oflag != level) {
        change_oflag(qtmr, timer, n, level);
    }
}

/* The count equals COMP1 (up) or COMP2 (down). */
NOINLINE static void compare(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n, bool up)
{
    qtmr_channel_t *c = &timer->channel[n];
    c->reg[SCTRL] = (uint16_t)(c->reg[SCTRL] | SCTRL_TCF);
    c->reg[CSCTRL] = (uint16_t)(c->reg[CSCTRL] | (up ? CSCTRL_TCF1 : CSCTRL_TCF2));
    switch (CTRL_OUTMODE(c->reg[CTRL])) {
    case OUT_CLEAR:
        set_oflag(qtmr, timer, n, false);
        break;
    case OUT_SET:
    case OUT_SET_SECONDARY:
    case OUT_SET_ROLLOVER:
        set_oflag(qtmr, timer, n, true);
        break;
    case OUT_TOGGLE:
        set_oflag(qtmr, timer, n, !c->oflag);
        break;
    default:
        break;
    }
    FOR_EACH(k, timer->cascade)
    {
        if (CTRL_PCS(timer->channel[k].reg[CTRL]) == 4u + n) {
            count(qtmr, timer, k, up);
        }
    }
    if ((c->reg[CTRL] & CTRL_ONCE) != 0) {
        c->reg[CTRL] = (uint16_t)(c->reg[CTRL] & 0x1FFFu);
        timer->on_bus &= ~(1u << n);
    }
    request(qtmr, timer, n);
}

NOINLINE static void rollover(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n)
{
    qtmr_channel_t *c = &timer->channel[n];
    c->reg[SCTRL] = (uint16_t)(c->reg[SCTRL] | SCTRL_TOF);
    if (CTRL_OUTMODE(c->reg[CTRL]) == OUT_SET_ROLLOVER) {
        set_oflag(qtmr, timer, n, false);
    }
    if ((c->reg[SCTRL] & SCTRL_TOFIE) != 0) {
        request(qtmr, timer, n);
    }
}

/* A count without a consequence. */
static inline void only_count(qtmr_channel_t *c, bool up)
{
    c->reg[CSCTRL] = (uint16_t)(up ? (c->reg[CSCTRL] | CSCTRL_UP) : (c->reg[CSCTRL] & ~CSCTRL_UP));
    c->reg[CNTR] = (uint16_t)(c->reg[CNTR] + (up ? 1u : 0xFFFFu));
}

/* One count. With LENGTH the count after a match is LOAD, in the direction of that match. */
static void count(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n, bool up)
{
    qtmr_channel_t *c = &timer->channel[n];
    if (!enabled(timer, n)) {
        return;
    }
    c->reg[CSCTRL] = (uint16_t)(up ? (c->reg[CSCTRL] | CSCTRL_UP) : (c->reg[CSCTRL] & ~CSCTRL_UP));
    const uint16_t limit = up ? c->reg[COMP1] : c->reg[COMP2];
    if ((c->reg[CTRL] & CTRL_LENGTH) != 0 && c->reg[CNTR] == limit) {
        c->reg[CNTR] = c->reg[LOAD];
    } else {
        c->reg[CNTR] = (uint16_t)(c->reg[CNTR] + (up ? 1u : 0xFFFFu));
        if (c->reg[CNTR] == (up ? 0u : 0xFFFFu)) {
            rollover(qtmr, timer, n);
        }
    }
    if (c->reg[CNTR] == limit) {
        compare(qtmr, timer, n, up);
    }
}

/* Counts to the next compare or rollover of a channel on the bus clock. At least 1. */
static uint32_t counts_to_event(const qtmr_channel_t *c)
{
    const bool down = counts_down(c);
    const uint16_t limit = down ? c->reg[COMP2] : c->reg[COMP1];
    if ((c->reg[CTRL] & CTRL_LENGTH) != 0 && c->reg[CNTR] == limit) {
        return 1u;
    }
    const uint32_t to_limit = (uint16_t)(down ? c->reg[CNTR] - limit : limit - c->reg[CNTR]);
    const uint32_t to_wrap = down ? c->reg[CNTR] + 1u : 0x10000u - c->reg[CNTR];
    return (to_limit != 0 && to_limit < to_wrap) ? to_limit : to_wrap;
}

static inline void settle_to(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n, uint64_t clock)
{
    qtmr_channel_t *c = &timer->channel[n];
    const unsigned shift = prescaler(c);
    uint64_t counts = (clock >> shift) - (c->since >> shift);
    c->since = clock;
    while (counts > 0 && runs_on_bus(timer, n)) {
        const uint32_t next = counts_to_event(c);
        if (counts < next) {
            c->reg[CNTR] = (uint16_t)(counts_down(c) ? c->reg[CNTR] - counts : c->reg[CNTR] + counts);
            break;
        }
        c->reg[CNTR] = (uint16_t)(counts_down(c) ? c->reg[CNTR] - (next - 1u) : c->reg[CNTR] + (next - 1u));
        count(qtmr, timer, n, !counts_down(c));
        counts -= next;
    }
}

NOINLINE static void settle_on_bus(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n)
{
    if (((timer->holds >> n) & 1u) != 0) {
        timer->holds &= ~(1u << n);
        settle_to(qtmr, timer, n, timer->hold_clock);
        timer->channel[n].reg[HOLD] = timer->channel[n].reg[CNTR];
    }
    settle_to(qtmr, timer, n, qtmr->bus->now);
}

static inline void settle(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n)
{
    if (runs_on_bus(timer, n)) {
        settle_on_bus(qtmr, timer, n);
    }
}

static void settle_all(qtmr_t *qtmr, qtmr_module_t *timer)
{
    FOR_EACH(n, timer->on_bus) { settle(qtmr, timer, n); }
}

/* A channel on the bus clock whose compares have no consequence has no events. */
static bool has_events(const qtmr_channel_t *c)
{
    return (c->reg[SCTRL] & (SCTRL_TCFIE | SCTRL_TOFIE)) != 0 ||
           (c->reg[CSCTRL] & (CSCTRL_TCF1EN | CSCTRL_TCF2EN)) != 0 || CTRL_OUTMODE(c->reg[CTRL]) != OUT_ACTIVE ||
           (c->reg[CTRL] & CTRL_ONCE) != 0;
}

/* The next event of the eventful channels. */
NOINLINE static uint64_t next_of_eventful(qtmr_t *qtmr, qtmr_module_t *timer)
{
    FOR_EACH(n, timer->eventful) { settle(qtmr, timer, n); }
    uint64_t next = CHIP_NEVER;
    FOR_EACH(n, timer->eventful & timer->on_bus)
    {
        const qtmr_channel_t *c = &timer->channel[n];
        const unsigned shift = prescaler(c);
        const uint64_t clock = ((qtmr->bus->now >> shift) + counts_to_event(c)) << shift;
        next = (clock < next) ? clock : next;
    }
    return next;
}

/* The first change behind the filters. */
static inline uint64_t first_change(const qtmr_module_t *timer)
{
    const uint64_t *change = timer->change_clock;
    return events_earlier(events_earlier(change[0], change[1]), events_earlier(change[2], change[3]));
}

static inline void schedule(qtmr_t *qtmr, qtmr_module_t *timer)
{
    timer->quiet_clock = CHIP_NEVER;
    const uint64_t next = (timer->eventful != 0) ? next_of_eventful(qtmr, timer) : CHIP_NEVER; /* may change an input */
    bus_plan(qtmr->bus, SOURCE_TIMER + timer->module, events_earlier(first_change(timer), next));
}

/* ---- inputs ---------------------------------------------------------------------------------------------------------- */

NOINLINE static void capture(qtmr_t *qtmr, qtmr_module_t *timer, unsigned n, bool rises)
{
    qtmr_channel_t *c = &timer->channel[n];
    const bool inverted = (c->reg[SCTRL] & SCTRL_IPS) != 0;
    const unsigned edge = (rises != inverted) ? 1u : 2u;
    if ((SCTRL_CAPTURE(c->reg[SCTRL]) & edge) == 0) {
        return;
    }
    settle(qtmr, timer, n);
    c->reg[CAPT] = c->reg[CNTR];
    c->reg[SCTRL] = (uint16_t)(c->reg[SCTRL] | SCTRL_IEF);
    timer->captured |= 1u << n;
    if ((c->reg[CSCTRL] & CSCTRL_ROC) != 0) {
        c->reg[CNTR] = c->reg[LOAD];
        if (timer->eventful != 0) {
            schedule(qtmr, timer);
        }
    }
    bus_note(qtmr->bus, TRACE_CAPTURE, timer->module * QTMR_CHANNELS + n, c->reg[CAPT]);
    if ((c->reg[SCTRL] & SCTRL_IEFIE) != 0) {
        request(qtmr, timer, n);
    }
}

/* A leads B upwards: after an edge of A the lines differ then, after one of B they are equal. */
static inline bool decodes_up(const qtmr_module_t *timer, const qtmr_channel_t *c, unsigned input)
{
    const unsigned a = CTRL_PCS(c->reg[CTRL]);
    const unsigned b = CTRL_SCS(c->reg[CTRL]);
    const bool differ = (((timer->in >> a) ^ (timer->in >> b)) & 1u) != 0;
    const bool up = (input == a) ? differ : !differ;
    return up != counts_down(c);
}

/* A channel that counts edges does so at this one. */
static inline bool counts_edge(const qtmr_channel_t *c, bool rises)
{
    return CTRL_CM(c->reg[CTRL]) == CM_BOTH || rises != ((c->reg[SCTRL] & SCTRL_IPS) != 0);
}

/* A level behind the filter has changed. What a secondary input does to OFLAG comes before the count, its capture after:
 * the captured count includes the edge. */
NOINLINE static void edge(qtmr_t *qtmr, qtmr_module_t *timer, unsigned input)
{
    timer->in ^= 1u << input;
    const bool rises = ((timer->in >> input) & 1u) != 0;
    FOR_EACH(n, timer->cleared_by[input]) { set_oflag(qtmr, timer, n, false); }
    FOR_EACH(n, timer->decodes[input]) { count(qtmr, timer, n, decodes_up(timer, &timer->channel[n], input)); }
    FOR_EACH(n, timer->counts_edges[input])
    {
        if (counts_edge(&timer->channel[n], rises)) {
            count(qtmr, timer, n, !counts_down(&timer->channel[n]));
        }
    }
    /* a captured count stays until software clears IEF */
    FOR_EACH(n, timer->captures[input] & ~timer->captured) { capture(qtmr, timer, n, rises); }
}

/* ---- edges that only count ------------------------------------------------------------------------------------------- */

/* Number of coming edges that only change a count: no compare, rollover, capture or output follows. */
static unsigned find_deferrable_edges(const qtmr_t *qtmr, const qtmr_module_t *timer)
{
    if (timer->eventful != 0 || qtmr->bus->events.key[SOURCE_TIMER + timer->module] < EVENT_KEY(CHIP_NEVER, 0)) {
        return 0;
    }
    unsigned counting = 0;
    unsigned capturing = 0;
    unsigned cleared = 0;
    for (unsigned input = 0; input < QTMR_CHANNELS; input++) {
        counting |= timer->decodes[input] | timer->counts_edges[input];
        capturing |= timer->captures[input];
        cleared |= timer->cleared_by[input];
    }
    if ((capturing & ~timer->captured) != 0) {
        return 0;
    }
    FOR_EACH(n, cleared)
    {
        if (timer->channel[n].oflag) {
            return 0;
        }
    }
    unsigned least = QTMR_DEFERRABLE_EDGES_MAX + QTMR_CHANNELS + 1u; /* one may be behind each filter */
    FOR_EACH(n, counting)
    {
        const qtmr_channel_t *c = &timer->channel[n];
        const uint16_t special[] = {c->reg[COMP1], c->reg[COMP2], 0, 0xFFFF};
        for (unsigned i = 0; i < sizeof special / sizeof special[0]; i++) {
            const uint16_t up = (uint16_t)(special[i] - c->reg[CNTR]);
            const uint16_t down = (uint16_t)(c->reg[CNTR] - special[i]);
            const uint16_t distance = (up < down) ? up : down;
            least = (distance < least) ? distance : least;
        }
    }
    return (least > QTMR_CHANNELS + 1u) ? least - QTMR_CHANNELS - 1u : 0u;
}

/* After a change of what edges do; the deferred ones must have been counted before. */
static void update_deferrable(qtmr_t *qtmr, qtmr_module_t *timer)
{
    const unsigned before = timer->deferrable_edges;
    timer->deferrable_edges = find_deferrable_edges(qtmr, timer);
    if (timer->deferrable_edges != before) {
        qtmr->bus->environment->deferrable_edges_changed(qtmr->bus->board);
    }
}

/* A deferrable edge passes its filter. */
static void count_quietly(qtmr_module_t *timer, unsigned input)
{
    timer->change_clock[input] = CHIP_NEVER;
    timer->in ^= 1u << input;
    const bool rises = ((timer->in >> input) & 1u) != 0;
    FOR_EACH(n, timer->decodes[input] & timer->enable)
    {
        qtmr_channel_t *c = &timer->channel[n];
        only_count(c, decodes_up(timer, c, input));
    }
    FOR_EACH(n, timer->counts_edges[input] & timer->enable)
    {
        qtmr_channel_t *c = &timer->channel[n];
        if (counts_edge(c, rises)) {
            only_count(c, !counts_down(c));
        }
    }
}

/* All such edges before `clock`, in order. */
static inline void pass_filters(qtmr_module_t *timer, uint64_t clock)
{
    while (timer->quiet_clock < clock) {
        unsigned input = 0;
        while (timer->change_clock[input] != timer->quiet_clock) {
            input++;
        }
        count_quietly(timer, input);
        timer->quiet_clock = first_change(timer);
    }
}

void qtmr_catch_up(qtmr_t *qtmr)
{
    if (qtmr->caught_up == qtmr->bus->now) {
        return;
    }
    qtmr->caught_up = qtmr->bus->now;
    bus_sync_plant(qtmr->bus);
    qtmr->bus->environment->report_deferred(qtmr->bus->board);
    for (unsigned m = 0; m < QTMR_MODULES; m++) {
        qtmr_module_t *timer = &qtmr->module[m];
        pass_filters(timer, qtmr->bus->now + 1u);
        if (timer->deferrable_edges > 0 &&
            timer->deferrable_edges < QTMR_DEFERRABLE_EDGES_MAX / 2u) { /* before none are left */
            update_deferrable(qtmr, timer);
        }
    }
}

/* ---- edges ----------------------------------------------------------------------------------------------------------- */

/* A new level at a filter. True if it passes without a delay. */
static inline bool enter_filter(qtmr_module_t *timer, unsigned input, bool level, uint64_t clock)
{
    pass_filters(timer, clock);
    timer->raw ^= 1u << input;
    if (((timer->in >> input) & 1u) == (level ? 1u : 0u)) {
        timer->change_clock[input] = CHIP_NEVER; /* shorter than the filter */
        return false;
    }
    if (timer->delay[input] == 0) {
        return true;
    }
    timer->change_clock[input] = clock + timer->delay[input];
    return false;
}

void qtmr_input(qtmr_t *qtmr, unsigned m, unsigned input, bool level, uint64_t clock)
{
    qtmr_module_t *timer = &qtmr->module[m];
    if (((timer->raw >> input) & 1u) == (level ? 1u : 0u)) {
        return;
    }
    if (timer->deferrable_edges > 0) {
        timer->deferrable_edges--;
        if (enter_filter(timer, input, level, clock)) {
            count_quietly(timer, input);
        }
        timer->quiet_clock = first_change(timer);
        return;
    }
    if (enter_filter(timer, input, level, qtmr->bus->now)) {
        edge(qtmr, timer, input);
    }
    schedule(qtmr, timer);
    update_deferrable(qtmr, timer);
}

void qtmr_pulse(qtmr_t *qtmr, unsigned m, unsigned input)
{
    qtmr_module_t *timer = &qtmr->module[m];
    if (timer->delay[input] == 0) {
        qtmr_catch_up(qtmr);
        edge(qtmr, timer, input);
        edge(qtmr, timer, input);
        schedule(qtmr, timer);
        update_deferrable(qtmr, timer);
    }
}

/* Edges that pass their filters at the present clock. */
void qtmr_event(void *peripheral, unsigned source)
{
    qtmr_t *qtmr = (qtmr_t *)peripheral;
    qtmr_module_t *timer = &qtmr->module[source - SOURCE_TIMER];
    qtmr_catch_up(qtmr);
    for (unsigned input = 0; input < QTMR_CHANNELS; input++) {
        if (timer->change_clock[input] <= qtmr->bus->now) {
            timer->change_clock[input] = CHIP_NEVER;
            edge(qtmr, timer, input);
        }
    }
    schedule(qtmr, timer);
    update_deferrable(qtmr, timer);
}

/* ---- registers ------------------------------------------------------------------------------------------------------- */

/* The masks of channels that follow from the registers. */
static void derive(qtmr_t *qtmr, qtmr_module_t *timer)
{
    settle_all(qtmr, timer);
    timer->on_bus = timer->cascade = 0;
    for (unsigned i = 0; i < QTMR_CHANNELS; i++) {
        timer->counts_edges[i] = timer->follows[i] = timer->captures[i] = timer->cleared_by[i] = 0;
        timer->decodes[i] = 0;
    }
    for (unsigned n = 0; n < QTMR_CHANNELS; n++) {
        qtmr_channel_t *c = &timer->channel[n];
        const unsigned bit = 1u << n;
        const unsigned mode = CTRL_CM(c->reg[CTRL]);
        const unsigned source = CTRL_PCS(c->reg[CTRL]);
        const bool gate = bus_gate_open(qtmr->bus, 0, ((timer->module == 0) ? 15u : 11u) - n);
        if (mode == CM_STOP || !gate) {
            continue;
        }
        if (mode == CM_QUADRATURE) {
            if (source < QTMR_CHANNELS) {
                timer->decodes[source] |= bit;
                timer->decodes[CTRL_SCS(c->reg[CTRL])] |= bit;
            }
        } else if (mode == CM_CASCADE) {
            timer->cascade |= bit;
        } else if (source >= FIRST_BUS_SOURCE) {
            if (enabled(timer, n)) {
                timer->on_bus |= bit;
                c->since = qtmr->bus->now;
            }
        } else if (source >= 4u) {
            timer->follows[source - 4u] |= bit;
        } else {
            timer->counts_edges[source] |= bit;
        }
        if (SCTRL_CAPTURE(c->reg[SCTRL]) != 0) {
            timer->captures[CTRL_SCS(c->reg[CTRL])] |= bit;
        }
        if (CTRL_OUTMODE(c->reg[CTRL]) == OUT_SET_SECONDARY) {
            timer->cleared_by[CTRL_SCS(c->reg[CTRL])] |= bit;
        }
    }
    timer->eventful = 0;
    for (unsigned n = 0; n < QTMR_CHANNELS; n++) {
        if (runs_on_bus(timer, n) &&
            (has_events(&timer->channel[n]) || timer->follows[n] != 0 || timer->cascade != 0)) {
            timer->eventful |= 1u << n;
        }
    }
    if (timer->on_bus != 0) {
        qtmr->bus->signals->need_bus_clock(qtmr->bus->chip, "a timer");
    }
    schedule(qtmr, timer);
}

void qtmr_gates_changed(qtmr_t *qtmr)
{
    qtmr_catch_up(qtmr);
    for (unsigned m = 0; m < QTMR_MODULES; m++) {
        derive(qtmr, &qtmr->module[m]);
        update_deferrable(qtmr, &qtmr->module[m]);
    }
}

static void write_ctrl(qtmr_t *qtmr, uint32_t address, qtmr_module_t *timer, unsigned n, uint16_t value)
{
    const unsigned mode = CTRL_CM(value);
    const unsigned source = CTRL_PCS(value);
    const unsigned out = CTRL_OUTMODE(value);
    if (mode == CM_GATED || mode == CM_SIGNED || mode == CM_TRIGGERED) {
        bus_no_value(qtmr->bus, address, value, "this count mode is not modelled");
    }
    if (out == OUT_ALTERNATE || out == OUT_GATED) {
        bus_no_value(qtmr->bus, address, value, "this output mode is not modelled");
    }
    if ((value & CTRL_COINIT) != 0) {
        bus_no_value(qtmr->bus, address, value, "COINIT is not modelled");
    }
    if (mode == CM_BOTH && source >= FIRST_BUS_SOURCE) {
        bus_no_value(qtmr->bus, address, value, "both edges of the bus clock are not modelled");
    }
    if (mode != CM_STOP && source == 4u + n) {
        bus_no_value(qtmr->bus, address, value, "a channel cannot count its own output");
    }
    settle(qtmr, timer, n);
    timer->channel[n].reg[CTRL] = value;
    derive(qtmr, timer);
}

static uint16_t read_channel(qtmr_t *qtmr, uint32_t address, qtmr_module_t *timer, unsigned n, uint32_t number)
{
    const qtmr_channel_t *c = &timer->channel[n];
    if (number == HOLD || number == CNTR || number == CTRL || number == SCTRL || number == CSCTRL) {
        settle(qtmr, timer, n);
    }
    if (number == CNTR) {
        for (unsigned k = 0; k < QTMR_CHANNELS; k++) { /* those on the bus clock are computed when they are read */
            timer->channel[k].reg[HOLD] = timer->channel[k].reg[CNTR];
        }
        timer->holds = timer->on_bus & ~(1u << n);
        timer->hold_clock = qtmr->bus->now;
    } else if (number == SCTRL) {
        const bool level = ((timer->in >> CTRL_SCS(c->reg[CTRL])) & 1u) != 0;
        return (uint16_t)(c->reg[SCTRL] | ((level != ((c->reg[SCTRL] & SCTRL_IPS) != 0)) ? SCTRL_INPUT : 0u));
    } else if (number == DMA) {
        return 0;
    } else if (number == ENBL && n == 0) {
        return timer->enable;
    } else if (number > FILT) {
        bus_no_register(qtmr->bus, address);
    }
    return c->reg[number];
}

static void write_sctrl(qtmr_t *qtmr, uint32_t address, qtmr_module_t *timer, unsigned n, uint16_t value)
{
    qtmr_channel_t *c = &timer->channel[n];
    bus_allow(qtmr->bus, address, value, 0xFFCF, "master and external OFLAG modes are not modelled");
    settle(qtmr, timer, n);
    const unsigned before = c->reg[SCTRL];
    const unsigned flags = before & value & SCTRL_FLAGS; /* a flag is cleared by writing 0, never set */
    c->reg[SCTRL] = (uint16_t)((value & ~(SCTRL_FLAGS | SCTRL_INPUT | SCTRL_FORCE)) | flags);
    timer->captured &= ~((flags & SCTRL_IEF) != 0 ? 0u : 1u << n);
    if ((value & SCTRL_FORCE) != 0) {
        set_oflag(qtmr, timer, n, (value & SCTRL_VAL) != 0);
    }
    if (((before ^ c->reg[SCTRL]) & ~(SCTRL_FLAGS | SCTRL_IEFIE)) != 0) {
        derive(qtmr, timer);
    }
    request(qtmr, timer, n);
}

static void write_csctrl(qtmr_t *qtmr, uint32_t address, qtmr_module_t *timer, unsigned n, uint16_t value)
{
    qtmr_channel_t *c = &timer->channel[n];
    bus_allow(qtmr->bus, address, value, 0xCAF0, "preloads, TCI, FAULT and ALT_LOAD are not modelled");
    settle(qtmr, timer, n);
    const unsigned flags = c->reg[CSCTRL] & value & (CSCTRL_TCF1 | CSCTRL_TCF2);
    const unsigned kept = c->reg[CSCTRL] & CSCTRL_UP;
    c->reg[CSCTRL] = (uint16_t)((value & ~(CSCTRL_TCF1 | CSCTRL_TCF2 | CSCTRL_UP)) | flags | kept);
    derive(qtmr, timer);
    request(qtmr, timer, n);
}

static void write_channel(qtmr_t *qtmr, uint32_t address, qtmr_module_t *timer, unsigned n, uint32_t number,
                          uint16_t value)
{
    qtmr_channel_t *c = &timer->channel[n];
    settle(qtmr, timer, n);
    switch (number) {
    case COMP1:
    case COMP2:
    case LOAD:
    case CNTR:
        c->reg[number] = value;
        break;
    case CAPT:
    case HOLD:
    case CMPLD1:
    case CMPLD2:
        c->reg[number] = value;
        return;
    case CTRL:
        write_ctrl(qtmr, address, timer, n, value);
        return;
    case SCTRL:
        write_sctrl(qtmr, address, timer, n, value);
        return;
    case CSCTRL:
        write_csctrl(qtmr, address, timer, n, value);
        return;
    case FILT:
        bus_allow(qtmr->bus, address, value, 0x07FF, "reserved");
        c->reg[FILT] = value;
        timer->delay[n] = (value & 0xFFu) * (((uint32_t)value >> 8) + 3u);
        return;
    case DMA:
        bus_allow(qtmr->bus, address, value, 0, "DMA is not modelled");
        return;
    case ENBL:
        if (n == 0) {
            settle_all(qtmr, timer);
            timer->enable = value & 0xFu;
            derive(qtmr, timer);
            return;
        }
        bus_no_register(qtmr->bus, address);
    default:
        bus_no_register(qtmr->bus, address);
    }
    schedule(qtmr, timer);
}

static void check_gate(qtmr_t *qtmr, uint32_t address, unsigned m, unsigned n)
{
    bus_check_gate(qtmr->bus, address, 0, ((m == 0) ? 15u : 11u) - n);
}

uint16_t qtmr_read(void *peripheral, uint32_t address)
{
    qtmr_t *qtmr = (qtmr_t *)peripheral;
    const unsigned m = (address - QTMR_BASE) / MODULE_SIZE;
    const unsigned n = ((address - QTMR_BASE) / 0x10u) % QTMR_CHANNELS;
    check_gate(qtmr, address, m, n);
    qtmr_catch_up(qtmr);
    return read_channel(qtmr, address, &qtmr->module[m], n, address & 0xFu);
}

void qtmr_write(void *peripheral, uint32_t address, uint16_t value)
{
    qtmr_t *qtmr = (qtmr_t *)peripheral;
    const unsigned m = (address - QTMR_BASE) / MODULE_SIZE;
    const unsigned n = ((address - QTMR_BASE) / 0x10u) % QTMR_CHANNELS;
    qtmr_module_t *timer = &qtmr->module[m];
    check_gate(qtmr, address, m, n);
    qtmr_catch_up(qtmr);
    write_channel(qtmr, address, timer, n, address & 0xFu, value);
    update_deferrable(qtmr, timer);
    if (timer->deferrable_edges == 0 && timer->quiet_clock != CHIP_NEVER) {
        schedule(qtmr, timer); /* an edge behind a filter has become an event */
    }
}

void qtmr_reset(void *peripheral)
{
    qtmr_t *qtmr = (qtmr_t *)peripheral;
    for (unsigned m = 0; m < QTMR_MODULES; m++) {
        qtmr->module[m] = (qtmr_module_t){.module = m, .enable = 0xF, .quiet_clock = CHIP_NEVER};
        for (unsigned i = 0; i < QTMR_CHANNELS; i++) {
            qtmr->module[m].change_clock[i] = CHIP_NEVER;
        }
    }
    qtmr->bus->environment->deferrable_edges_changed(qtmr->bus->board);
}
