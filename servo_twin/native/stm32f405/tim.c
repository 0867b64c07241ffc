#include "stm32f405/tim.h"

#include "port/stm32f405/registers.h"

#define CR1_OPM 0x08u
#define SR_CCIF(k) (2u << (k))
#define SR_TIF 0x040u
#define SR_BIF 0x080u
#define SR_CCOF(k) (0x200u << (k))
#define EGR_BG 0x80u

/* Modes of an output. */
enum { FROZEN, ACTIVE_ON_MATCH, INACTIVE_ON_MATCH, TOGGLE, FORCE_INACTIVE, FORCE_ACTIVE, PWM1, PWM2 };

enum { SLAVE_OFF, SLAVE_ENCODER_TI2, SLAVE_ENCODER_TI1, SLAVE_ENCODER_BOTH, SLAVE_RESET, SLAVE_GATED, SLAVE_TRIGGER };
enum { MASTER_RESET, MASTER_ENABLE, MASTER_UPDATE, MASTER_COMPARE_PULSE, MASTER_OC1REF };

/* What differs between the timers. ITR0..3 are RM0090's tables of internal triggers; SOC_TIMERS: one that is not modelled. */
static const struct {
    const char *name;
    bool advanced, wide; /* complementary outputs; 32 bits */
    uint8_t clocks; /* of 168 MHz per clock of the timer */
    uint8_t gate, bit; /* soc_gate_t, bit of the enable register */
    uint8_t irq_update, irq_compare, irq_trigger, irq_break, holder;
    uint8_t itr[4];
} kinds[SOC_TIMERS] = {
    [SOC_TIM1] = {"TIM1",
                  true,
                  false,
                  1,
                  SOC_APB2,
                  0,
                  SOC_IRQ_TIM1_UP,
                  SOC_IRQ_TIM1_CC,
                  SOC_IRQ_TIM1_TRG,
                  SOC_IRQ_TIM1_BRK,
                  0,
                  {SOC_TIM5, SOC_TIM2, SOC_TIM3, SOC_TIM4}},
    [SOC_TIM8] = {"TIM8",
                  true,
                  false,
                  1,
                  SOC_APB2,
                  1,
                  SOC_IRQ_TIM8_UP,
                  SOC_IRQ_TIM8_CC,
                  SOC_IRQ_TIM8_TRG,
                  SOC_IRQ_TIM8_BRK,
                  0,
                  {SOC_TIM1, SOC_TIM2, SOC_TIM4, SOC_TIM5}},
    [SOC_TIM2] = {"TIM2",
                  false,
                  true,
                  2,
                  SOC_APB1,
                  0,
                  SOC_IRQ_TIM2,
                  SOC_IRQ_TIM2,
                  SOC_IRQ_TIM2,
                  SOC_IRQ_TIM2,
                  0,
                  {SOC_TIM1, SOC_TIM8, SOC_TIM3, SOC_TIM4}},
    [SOC_TIM3] = {"TIM3",
                  false,
                  false,
                  2,
                  SOC_APB1,
                  1,
                  SOC_IRQ_TIM3,
                  SOC_IRQ_TIM3,
                  SOC_IRQ_TIM3,
                  SOC_IRQ_TIM3,
                  0,
                  {SOC_TIM1, SOC_TIM2, SOC_TIM5, SOC_TIM4}},
    [SOC_TIM4] = {"TIM4",
                  false,
                  false,
                  2,
                  SOC_APB1,
                  2,
                  SOC_IRQ_TIM4,
                  SOC_IRQ_TIM4,
                  SOC_IRQ_TIM4,
                  SOC_IRQ_TIM4,
                  0,
                  {SOC_TIM1, SOC_TIM2, SOC_TIM3, SOC_TIM8}},
    [SOC_TIM5] = {"TIM5",
                  false,
                  true,
                  2,
                  SOC_APB1,
                  3,
                  SOC_IRQ_TIM5,
                  SOC_IRQ_TIM5,
                  SOC_IRQ_TIM5,
                  SOC_IRQ_TIM5,
                  0,
                  {SOC_TIM2, SOC_TIM3, SOC_TIM4, SOC_TIM8}},
    [SOC_TIM12] = {"TIM12",
                   false,
                   false,
                   2,
                   SOC_APB1,
                   6,
                   SOC_IRQ_TIM8_BRK,
                   SOC_IRQ_TIM8_BRK,
                   SOC_IRQ_TIM8_BRK,
                   SOC_IRQ_TIM8_BRK,
                   1,
                   {SOC_TIM4, SOC_TIM5, SOC_TIMERS, SOC_TIMERS}},
};

/* ---- settings ------------------------------------------------------------------------------------------------------- */

static bool advanced(const tim_t *tim) { return kinds[tim->id].advanced; }

static bool centred(const tim_t *tim) { return (tim->cr1 & FIELD_MASK(TIM_CR1_CMS)) != 0; }

static bool counts_edges(const tim_t *tim)
{
    const uint32_t mode = tim->smcr & FIELD_MASK(TIM_SMCR_SMS);
    return mode >= SLAVE_ENCODER_TI2 && mode <= SLAVE_ENCODER_BOTH;
}

static bool runs(const tim_t *tim) { return (tim->cr1 & TIM_CR1_CEN) != 0 && !counts_edges(tim); }

static uint64_t tick(const tim_t *tim) { return (uint64_t)kinds[tim->id].clocks * (tim->active_psc + 1u); }

/* Ticks of a cycle. */
static uint64_t span(const tim_t *tim)
{
    return centred(tim) ? 2u * (uint64_t)tim->active_arr : (uint64_t)tim->active_arr + 1u;
}

/* Field of a channel in CCMR: CCxS at 0, OCxPE at 3, OCxM at 4, OCxCE at 7. */
static uint32_t setting(const tim_t *tim, unsigned k) { return tim->ccmr[k / 2u] >> (8u * (k % 2u)) & 0xFFu; }

static unsigned selection(const tim_t *tim, unsigned k) { return setting(tim, k) & 3u; }

static bool preloads(const tim_t *tim, unsigned k) { return (setting(tim, k) & 8u) != 0; }

static unsigned mode_of(const tim_t *tim, unsigned k) { return setting(tim, k) >> 4 & 7u; }

/* Bits of a channel in TIM_CCER: CCxE 1, CCxP 2, CCxNE 4, CCxNP 8. */
static uint32_t enabling(const tim_t *tim, unsigned k) { return tim->ccer >> (4u * k) & 15u; }

static bool compares(const tim_t *tim, unsigned k)
{
    return selection(tim, k) == 0 && (mode_of(tim, k) != FROZEN || (tim->dier & SR_CCIF(k)) != 0);
}

/* Dead time [clocks]; CKD does not divide. */
static uint64_t dead_time(const tim_t *tim)
{
    const uint32_t code = tim->bdtr & 0xFFu;
    if (code < 0x80u) {
        return code;
    }
    if (code < 0xC0u) {
        return (64u + (code & 0x3Fu)) * 2u;
    }
    return (32u + (code & 0x1Fu)) * ((code < 0xE0u) ? 8u : 16u);
}

static uint32_t position(const tim_t *tim)
{
    return runs(tim) ? (uint32_t)((tim->soc->bus.now - tim->origin) / tick(tim)) : tim->position;
}

static uint32_t count_at(const tim_t *tim, uint32_t at)
{
    return (centred(tim) && at > tim->active_arr) ? (uint32_t)(span(tim) - at) : at;
}

uint32_t tim_count(const tim_t *tim) { return count_at(tim, position(tim)); }

/* ---- requests and triggers ------------------------------------------------------------------------------------------ */

static void request(tim_t *tim)
{
    const uint32_t active = tim->sr & tim->dier;
    const uint32_t compare = SR_CCIF(0) | SR_CCIF(1) | SR_CCIF(2) | SR_CCIF(3);
    soc_t *soc = tim->soc;
    const unsigned holder = kinds[tim->id].holder;
    if (!advanced(tim)) {
        soc_request(soc, kinds[tim->id].irq_update, holder, (active & (TIM_SR_UIF | compare | SR_TIF)) != 0);
        return;
    }
    soc_request(soc, kinds[tim->id].irq_update, holder, (active & TIM_SR_UIF) != 0);
    soc_request(soc, kinds[tim->id].irq_compare, holder, (active & compare) != 0);
    soc_request(soc, kinds[tim->id].irq_trigger, holder, (active & SR_TIF) != 0);
    soc_request(soc, kinds[tim->id].irq_break, holder, (active & SR_BIF) != 0);
}

static void flag(tim_t *tim, uint32_t flags)
{
    tim->sr |= flags;
    request(tim);
}

static void trigger_out(tim_t *tim, unsigned mode)
{
    if (FIELD_GET(tim->cr2, TIM_CR2_MMS) == mode) {
        tim->soc->signals->trigger(tim->soc->chip, (soc_timer_t)tim->id, SOC_TRIGGER_TRGO, true);
        tim->soc->signals->trigger(tim->soc->chip, (soc_timer_t)tim->id, SOC_TRIGGER_TRGO, false);
    }
}

/* ---- outputs -------------------------------------------------------------------------------------------------------- */

/* Levels of the outputs of a channel; an output that is off is low, by the resistor of what it drives. */
static unsigned levels_of(const tim_t *tim, unsigned k)
{
    const tim_channel_t *c = &tim->channel[k];
    const uint32_t on = enabling(tim, k);
    const unsigned inverts = (on >> 1 & 1u) | (on >> 2 & 2u);
    const unsigned enabled = (on & 1u) | (on >> 1 & 2u);
    if (!advanced(tim)) {
        return (enabled & 1u) & ((c->ref ? 1u : 0u) ^ (inverts & 1u));
    }
    if ((tim->bdtr & TIM_BDTR_MOE) == 0) { /* the idle states are inactive */
        return ((tim->bdtr & TIM_BDTR_OSSI) != 0) ? enabled & inverts : 0u;
    }
    unsigned active = 0;
    if (enabled == 3u) {
        active = (c->dead_clock != CHIP_NEVER) ? 0u : c->out ? 1u : 2u;
    } else {
        active = c->ref ? enabled : 0u; /* of OCxN alone: OCxREF, not its complement */
    }
    const unsigned driven = ((tim->bdtr & TIM_BDTR_OSSR) != 0 && enabled != 0) ? 3u : enabled;
    return driven & (active ^ inverts);
}

static void update_outputs(tim_t *tim)
{
    bool changed = false;
    for (unsigned k = 0; k < TIM_CHANNELS; k++) {
        tim_channel_t *c = &tim->channel[k];
        const unsigned levels = levels_of(tim, k);
        if (levels != c->levels) {
            c->levels = levels;
            changed = true;
        }
    }
    if (changed) {
        tim->soc->signals->timer_pins(tim->soc->chip, (soc_timer_t)tim->id);
    }
}

/* OCxREF of the modes that follow the position. */
static bool reference(const tim_t *tim, unsigned k, uint32_t at)
{
    const tim_channel_t *c = &tim->channel[k];
    switch (mode_of(tim, k)) {
    case FORCE_INACTIVE:
        return false;
    case FORCE_ACTIVE:
        return true;
    case PWM1:
    case PWM2: {
        const bool back = centred(tim) && at >= tim->active_arr;
        const bool below = back ? span(tim) - at <= c->active : at < c->active;
        return below == (mode_of(tim, k) == PWM1);
    }
    default:
        return c->ref;
    }
}

static void set_reference(tim_t *tim, unsigned k, bool level)
{
    tim_channel_t *c = &tim->channel[k];
    soc_t *soc = tim->soc;
    if (level != c->ref) {
        c->ref = level;
        if (FIELD_GET(tim->cr2, TIM_CR2_MMS) == MASTER_OC1REF + k) {
            soc->signals->trigger(soc->chip, (soc_timer_t)tim->id, SOC_TRIGGER_TRGO, level);
        }
        if ((enabling(tim, k) & 1u) != 0) {
            const bool inverted = (enabling(tim, k) & 2u) != 0;
            soc->signals->trigger(soc->chip, (soc_timer_t)tim->id, (soc_trigger_t)(SOC_TRIGGER_CC1 + k),
                                  level != inverted);
        }
    }
    if (level != c->out) {
        c->out = level;
        c->dead_clock = (advanced(tim) && k < 3u && dead_time(tim) > 0) ? soc->bus.now + dead_time(tim) : CHIP_NEVER;
    }
}

/* ---- events --------------------------------------------------------------------------------------------------------- */

static void earlier(const tim_t *tim, uint64_t candidate, uint64_t *next)
{
    if (candidate > tim->done && candidate < *next) {
        *next = candidate;
    }
}

static void schedule(tim_t *tim)
{
    uint64_t clock = CHIP_NEVER;
    if (runs(tim)) {
        uint64_t next = span(tim);
        if (centred(tim)) {
            earlier(tim, tim->active_arr, &next);
        }
        for (unsigned k = 0; k < TIM_CHANNELS; k++) {
            const uint64_t at = tim->channel[k].active;
            if (compares(tim, k) && at <= tim->active_arr) {
                earlier(tim, at, &next);
                if (centred(tim)) {
                    earlier(tim, span(tim) - at, &next);
                }
            }
        }
        clock = tim->origin + next * tick(tim);
    }
    for (unsigned k = 0; k < TIM_CHANNELS; k++) {
        clock = events_earlier(clock, tim->channel[k].dead_clock);
    }
    bus_plan(&tim->soc->bus, SOC_EVENT_TIMER + tim->id, clock);
}

/* References, outputs and the next event, after any change. */
static void follow(tim_t *tim)
{
    const uint32_t at = counts_edges(tim) ? 0u : position(tim);
    for (unsigned k = 0; k < TIM_CHANNELS; k++) {
        if (selection(tim, k) == 0) {
            set_reference(tim, k, reference(tim, k, at));
        }
    }
    update_outputs(tim);
    schedule(tim);
}

/* Load what is buffered. */
static void load(tim_t *tim)
{
    tim->active_psc = tim->psc;
    tim->active_arr = tim->arr;
    for (unsigned k = 0; k < TIM_CHANNELS; k++) {
        if (selection(tim, k) == 0) {
            tim->channel[k].active = tim->channel[k].ccr;
        }
    }
    tim->repetitions = tim->rcr;
}

static void update_event(tim_t *tim, bool sets_flag)
{
    if ((tim->cr1 & TIM_CR1_UDIS) != 0) {
        return;
    }
    load(tim);
    if ((tim->bdtr & TIM_BDTR_AOE) != 0) {
        tim->bdtr |= TIM_BDTR_MOE;
    }
    if (sets_flag) {
        flag(tim, TIM_SR_UIF);
    }
    trigger_out(tim, MASTER_UPDATE);
}

/* Overflow or underflow. */
static void end_of_count(tim_t *tim)
{
    if (tim->repetitions > 0) {
        tim->repetitions--;
        return;
    }
    update_event(tim, true);
    if ((tim->cr1 & CR1_OPM) != 0) {
        tim->position = 0;
        tim->cr1 &= ~TIM_CR1_CEN;
    }
}

static void match(tim_t *tim, unsigned k, bool up)
{
    const uint32_t alignment = tim->cr1 & FIELD_MASK(TIM_CR1_CMS);
    const bool flags = alignment == FIELD_MASK(TIM_CR1_CMS) || alignment == 0 || (alignment == 0x40u) == up;
    const tim_channel_t *c = &tim->channel[k];
    switch (mode_of(tim, k)) {
    case ACTIVE_ON_MATCH:
        set_reference(tim, k, true);
        break;
    case INACTIVE_ON_MATCH:
        set_reference(tim, k, false);
        break;
    case TOGGLE:
        set_reference(tim, k, !c->ref);
        break;
    default:
        break;
    }
    if (flags) {
        flag(tim, SR_CCIF(k));
        if (k == 0) {
            trigger_out(tim, MASTER_COMPARE_PULSE);
        }
    }
}

static void reach(tim_t *tim, uint32_t at, bool wrapped)
{
    const bool middle = centred(tim) && at == tim->active_arr;
    for (unsigned k = 0; k < TIM_CHANNELS; k++) {
        const uint32_t compare = tim->channel[k].active;
        if (compares(tim, k) && count_at(tim, at) == compare) {
            match(tim, k, at <= tim->active_arr);
        }
    }
    tim->done = at;
    if (wrapped || middle) {
        const uint32_t arr = tim->active_arr;
        end_of_count(tim);
        if (middle && arr != tim->active_arr) {
            soc_no_value(tim->soc, kinds[tim->id].name, TIM_ARR, tim->arr,
                         "a new period in the middle of one is not modelled");
        }
    }
}

void tim_event(void *peripheral, unsigned source)
{
    tim_t *tim = (tim_t *)peripheral;
    const uint64_t now = tim->soc->bus.now;
    (void)source;
    for (unsigned k = 0; k < TIM_CHANNELS; k++) {
        if (tim->channel[k].dead_clock <= now) {
            tim->channel[k].dead_clock = CHIP_NEVER;
        }
    }
    if (runs(tim)) {
        uint64_t at = (now - tim->origin) / tick(tim);
        const bool wrapped = at >= span(tim);
        const bool on_tick = (now - tim->origin) % tick(tim) == 0;
        if (wrapped) {
            tim->origin += span(tim) * tick(tim);
            at = 0;
        }
        if (wrapped || (on_tick && at > tim->done)) {
            reach(tim, (uint32_t)at, wrapped);
        }
    }
    follow(tim);
}

/* ---- inputs --------------------------------------------------------------------------------------------------------- */

static void capture(tim_t *tim, unsigned k)
{
    tim_channel_t *c = &tim->channel[k];
    if ((enabling(tim, k) & 1u) == 0) {
        return;
    }
    c->ccr = tim_count(tim);
    flag(tim, SR_CCIF(k) | ((tim->sr & SR_CCIF(k)) != 0 ? SR_CCOF(k) : 0u));
    bus_note(&tim->soc->bus, TRACE_CAPTURE, 4u * tim->id + k, c->ccr);
    if (k == 0) {
        trigger_out(tim, MASTER_COMPARE_PULSE);
    }
}

/* Count an edge of the encoder. */
static void count_edge(tim_t *tim, bool up)
{
    tim->down = !up;
    const bool end = up ? tim->position >= tim->active_arr : tim->position == 0;
    if (end) {
        tim->position = up ? 0u : tim->active_arr;
        end_of_count(tim);
    } else {
        tim->position = up ? tim->position + 1u : tim->position - 1u;
    }
}

static bool inverted(const tim_t *tim, unsigned input) { return (enabling(tim, input) & 2u) != 0; }

void tim_input(tim_t *tim, unsigned input, bool level)
{
    if (tim->input[input] == level) {
        return;
    }
    tim->input[input] = level;
    const uint32_t mode = tim->smcr & FIELD_MASK(TIM_SMCR_SMS);
    if ((tim->cr1 & TIM_CR1_CEN) != 0 && counts_edges(tim) &&
        (mode == SLAVE_ENCODER_BOTH || (mode == SLAVE_ENCODER_TI1) == (input == 0))) {
        const bool a = tim->input[0] != inverted(tim, 0), b = tim->input[1] != inverted(tim, 1);
        count_edge(tim, (a != b) == (input == 0));
    }
    for (unsigned k = 0; k < 2u; k++) {
        const unsigned from = selection(tim, k);
        const uint32_t polarity = enabling(tim, k) & 0xAu;
        const bool selected = (from == 1u && k == input) || (from == 2u && k != input);
        if (selected && (polarity == 0xAu || level == (polarity == 0))) {
            capture(tim, k);
        }
    }
    follow(tim);
}

static void start(tim_t *tim)
{
    if ((tim->cr1 & TIM_CR1_CEN) == 0) {
        soc_need_clock(tim->soc, kinds[tim->id].name);
        tim->cr1 |= TIM_CR1_CEN;
        tim->origin = tim->soc->bus.now - tim->position * tick(tim);
        tim->done = tim->position;
        trigger_out(tim, MASTER_ENABLE);
    }
}

static void restart(tim_t *tim)
{
    tim->position = tim->done = 0;
    tim->origin = tim->soc->bus.now;
    update_event(tim, (tim->cr1 & TIM_CR1_URS) == 0);
}

void tim_internal_trigger(tim_t *tim, soc_timer_t from)
{
    const uint32_t selected = FIELD_GET(tim->smcr, TIM_SMCR_TS);
    if (selected >= 4u || kinds[tim->id].itr[selected] != (uint8_t)from) {
        return;
    }
    for (unsigned k = 0; k < TIM_CHANNELS; k++) {
        if (selection(tim, k) == 3u) {
            capture(tim, k);
        }
    }
    const uint32_t mode = tim->smcr & FIELD_MASK(TIM_SMCR_SMS);
    if (mode == SLAVE_TRIGGER) {
        flag(tim, SR_TIF);
        start(tim);
    } else if (mode == SLAVE_RESET) {
        flag(tim, SR_TIF);
        restart(tim);
    }
    follow(tim);
}

/* ---- registers ------------------------------------------------------------------------------------------------------ */

static uint32_t width(const tim_t *tim) { return kinds[tim->id].wide ? UINT32_MAX : 0xFFFFu; }

uint32_t tim_read(void *peripheral, uint32_t offset)
{
    tim_t *tim = (tim_t *)peripheral;
    const char *name = kinds[tim->id].name;
    soc_check_gate(tim->soc, name, (soc_gate_t)kinds[tim->id].gate, kinds[tim->id].bit);
    switch (offset) {
    case TIM_CR1: {
        const bool back = counts_edges(tim) ? tim->down : centred(tim) && position(tim) >= tim->active_arr;
        return (tim->cr1 & ~TIM_CR1_DIR) | (back ? TIM_CR1_DIR : 0u);
    }
    case TIM_CR2:
        return tim->cr2;
    case TIM_SMCR:
        return tim->smcr;
    case TIM_DIER:
        return tim->dier;
    case TIM_SR:
        return tim->sr;
    case TIM_EGR:
        return 0;
    case TIM_CCMR1:
        return tim->ccmr[0];
    case TIM_CCMR2:
        return tim->ccmr[1];
    case TIM_CCER:
        return tim->ccer;
    case TIM_CNT:
        return tim_count(tim);
    case TIM_PSC:
        return tim->psc;
    case TIM_ARR:
        return tim->arr;
    case TIM_RCR:
    case TIM_BDTR:
        if (!advanced(tim)) {
            soc_no_register(tim->soc, name, offset);
        }
        return (offset == TIM_RCR) ? tim->rcr : tim->bdtr;
    default:
        if (offset < TIM_CCR1 || offset > TIM_CCR4) {
            soc_no_register(tim->soc, name, offset);
        }
        break;
    }
    const unsigned k = (offset - TIM_CCR1) / 4u;
    if (selection(tim, k) != 0) { /* reading a capture clears its flag */
        tim->sr &= ~SR_CCIF(k);
        request(tim);
    }
    return tim->channel[k].ccr;
}

static void write_cr1(tim_t *tim, uint32_t value)
{
    const char *name = kinds[tim->id].name;
    soc_allow(tim->soc, name, TIM_CR1, value & ~0x300u, 0xEFu, "down-counting is not modelled");
    const uint32_t before = position(tim);
    if ((tim->cr1 & TIM_CR1_CEN) != 0 && ((value ^ tim->cr1) & FIELD_MASK(TIM_CR1_CMS)) != 0) {
        soc_no_value(tim->soc, name, TIM_CR1, value, "another alignment while the counter runs");
    }
    const bool starts = (value & ~tim->cr1 & TIM_CR1_CEN) != 0;
    if ((value & TIM_CR1_CEN) == 0 && runs(tim)) {
        tim->position = before;
    }
    tim->cr1 = (value & ~TIM_CR1_CEN) | (tim->cr1 & value & TIM_CR1_CEN);
    if ((tim->cr1 & TIM_CR1_ARPE) == 0) {
        tim->active_arr = tim->arr;
    }
    if (starts) {
        start(tim);
    }
}

static void write_smcr(tim_t *tim, uint32_t value)
{
    const char *name = kinds[tim->id].name;
    const uint32_t mode = value & FIELD_MASK(TIM_SMCR_SMS);
    soc_allow(tim->soc, name, TIM_SMCR, value, 0xF7u, "the external trigger input is not modelled");
    if (mode == SLAVE_GATED || mode > SLAVE_TRIGGER || (mode >= SLAVE_RESET && FIELD_GET(value, TIM_SMCR_TS) >= 4u)) {
        soc_no_value(tim->soc, name, TIM_SMCR, value, "this slave mode is not modelled");
    }
    const bool counted_edges = counts_edges(tim);
    tim->smcr = value;
    if ((tim->cr1 & TIM_CR1_CEN) != 0 && counts_edges(tim) != counted_edges) {
        soc_no_value(tim->soc, name, TIM_SMCR, value, "another clock while the counter runs");
    }
}

static void write_ccmr(tim_t *tim, unsigned n, uint32_t value)
{
    const char *name = kinds[tim->id].name;
    for (unsigned half = 0; half < 2u; half++) {
        const uint32_t field = value >> (8u * half) & 0xFFu;
        const bool input = (field & 3u) != 0;
        if (!input && (field & 0x84u) != 0) {
            soc_no_value(tim->soc, name, TIM_CCMR1 + 4u * n, value,
                         "fast enable and clear of an output are not modelled");
        }
        if (input && (n != 0 || (field & 0x0Cu) != 0)) {
            soc_no_value(tim->soc, name, TIM_CCMR1 + 4u * n, value,
                         "captures of channels 3, 4 and their prescalers are not modelled");
        }
    }
    tim->ccmr[n] = value & 0xFFFFu;
}

static void write_bdtr(tim_t *tim, uint32_t value)
{
    soc_allow(tim->soc, kinds[tim->id].name, TIM_BDTR, value, 0xFFFFu, "no such bits");
    uint32_t keep = 0;
    if (tim->locked) { /* LOCK can be written once after a reset */
        const uint32_t level = (tim->bdtr & FIELD_MASK(TIM_BDTR_LOCK)) >> 8;
        keep = FIELD_MASK(TIM_BDTR_LOCK) | (level >= 1u ? 0x70FFu : 0u) |
               (level >= 2u ? TIM_BDTR_OSSI | TIM_BDTR_OSSR : 0u);
    }
    tim->locked = tim->locked || (value & FIELD_MASK(TIM_BDTR_LOCK)) != 0;
    tim->bdtr = (value & ~keep) | (tim->bdtr & keep);
}

static void write_count(tim_t *tim, uint32_t value)
{
    const bool back = centred(tim) && position(tim) >= tim->active_arr;
    const uint32_t at = (back && value > 0) ? (uint32_t)(span(tim) - value) : value;
    tim->position = tim->done = at;
    tim->origin = tim->soc->bus.now - at * tick(tim);
}

static void generate(tim_t *tim, uint32_t value)
{
    soc_allow(tim->soc, kinds[tim->id].name, TIM_EGR, value, TIM_EGR_UG | EGR_BG | 0x1Eu,
              "COM and trigger events are not modelled");
    if ((value & TIM_EGR_UG) != 0) {
        restart(tim);
        trigger_out(tim, MASTER_RESET);
    }
    for (unsigned k = 0; k < TIM_CHANNELS; k++) {
        if ((value & SR_CCIF(k)) != 0) {
            flag(tim, SR_CCIF(k));
        }
    }
    if ((value & EGR_BG) != 0 && advanced(tim)) {
        tim->bdtr &= ~TIM_BDTR_MOE;
        flag(tim, SR_BIF);
    }
}

static void write_compare(tim_t *tim, unsigned k, uint32_t value)
{
    tim_channel_t *c = &tim->channel[k];
    c->ccr = value & width(tim);
    if (!preloads(tim, k)) {
        c->active = c->ccr;
    }
}

void tim_write(void *peripheral, uint32_t offset, uint32_t value)
{
    tim_t *tim = (tim_t *)peripheral;
    const char *name = kinds[tim->id].name;
    soc_check_gate(tim->soc, name, (soc_gate_t)kinds[tim->id].gate, kinds[tim->id].bit);
    switch (offset) {
    case TIM_CR1:
        write_cr1(tim, value);
        break;
    case TIM_CR2:
        soc_allow(tim->soc, name, TIM_CR2, value, 0x70u, "idle states, TI1S and commutation are not modelled");
        tim->cr2 = value;
        break;
    case TIM_SMCR:
        write_smcr(tim, value);
        break;
    case TIM_DIER:
        soc_allow(tim->soc, name, TIM_DIER, value, 0xDFu, "requests to the DMA and commutation are not modelled");
        tim->dier = value;
        break;
    case TIM_SR:
        tim->sr &= value;
        break;
    case TIM_EGR:
        generate(tim, value);
        break;
    case TIM_CCMR1:
    case TIM_CCMR2:
        write_ccmr(tim, (offset - TIM_CCMR1) / 4u, value);
        break;
    case TIM_CCER:
        tim->ccer = value & 0xFFFFu;
        break;
    case TIM_CNT:
        write_count(tim, value & width(tim));
        break;
    case TIM_PSC:
        tim->psc = value & 0xFFFFu;
        break;
    case TIM_ARR:
        tim->arr = value & width(tim);
        if ((tim->cr1 & TIM_CR1_ARPE) == 0) {
            tim->active_arr = tim->arr;
        }
        break;
    case TIM_RCR:
    case TIM_BDTR:
        if (!advanced(tim)) {
            soc_no_register(tim->soc, name, offset);
        }
        if (offset == TIM_RCR) {
            tim->rcr = value & 0xFFu;
        } else {
            write_bdtr(tim, value);
        }
        break;
    default:
        if (offset < TIM_CCR1 || offset > TIM_CCR4) {
            soc_no_register(tim->soc, name, offset);
        }
        write_compare(tim, (offset - TIM_CCR1) / 4u, value);
        break;
    }
    request(tim);
    follow(tim);
}

void tim_reset(void *peripheral, soc_reset_t cause)
{
    tim_t *tim = (tim_t *)peripheral;
    const bool input[2] = {tim->input[0], tim->input[1]};
    (void)cause;
    tim_t fresh = {.soc = tim->soc, .id = tim->id, .input = {input[0], input[1]}};
    fresh.arr = fresh.active_arr = width(tim);
    for (unsigned k = 0; k < TIM_CHANNELS; k++) {
        fresh.channel[k].dead_clock = CHIP_NEVER;
        fresh.channel[k].levels = tim->channel[k].levels;
    }
    *tim = fresh;
    request(tim);
    follow(tim);
}

void tim_init(tim_t *tim, soc_t *soc, soc_timer_t id)
{
    tim->soc = soc;
    tim->id = (uint8_t)id;
}
