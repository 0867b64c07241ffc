/* Reset, external interrupts with priorities, their frames on the stack, and the system control space. */
#include "arm/arm.h"
#include "arm/cycles.h"

#define FIRST 16u /* exception number of interrupt 0 */
#define PRIORITY_MASK 0xF0u /* four bits are implemented */
#define LOWEST 0x100u /* below every priority */
#define RETURN_HANDLER 0xFFFFFFF1u
#define RETURN_THREAD 0xFFFFFFF9u
#define FRAME 32u /* bytes */
#define XPSR_THUMB 0x01000000u
#define XPSR_ALIGNED 0x200u /* the stack pointer was moved by a word */

#define WORDS (ARM_INTERRUPTS / 32u)

/* ---- program status ------------------------------------------------------------------------------------------------- */

uint32_t arm_xpsr(const arm_t *arm)
{
    const arm_state_t *s = &arm->state;
    const uint32_t it = s->it;
    return (s->negative & 0x80000000u) | (s->nonzero == 0u ? 0x40000000u : 0u) | s->carry << 29 |
           (s->overflow >> 31) << 28 | s->saturated << 27 | (it & 3u) << 25 | XPSR_THUMB | s->ge << 16 |
           (it & 0xFCu) << 8 | s->exception;
}

void arm_set_flags(arm_t *arm, uint32_t xpsr)
{
    arm_state_t *s = &arm->state;
    s->negative = xpsr;
    s->nonzero = ~xpsr & 0x40000000u;
    s->carry = xpsr >> 29 & 1u;
    s->overflow = xpsr << 3;
    s->saturated = xpsr >> 27 & 1u;
    s->ge = xpsr >> 16 & 15u;
}

/* ---- reset, calls --------------------------------------------------------------------------------------------------- */

void arm_reset(arm_t *arm)
{
    const uint64_t instructions = arm->state.instructions;
    const uint32_t base = arm->boot;
    arm_forget(arm);
    arm->state = (arm_state_t){.vtor = base, .instructions = instructions, .nonzero = 1};
    arm->op = NULL;
    arm->state.r[ARM_SP] = arm_load_slow(arm, base, 4u) & ~3u;
    const uint32_t entry = arm_load_slow(arm, base + 4u, 4u);
    arm->state.r[ARM_LR] = 0xFFFFFFFFu;
    arm->state.pc = entry & ~1u;
    if (arm_slot(arm, arm->state.pc) == NULL || (entry & 1u) == 0u) {
        arm->state.pc = base;
        arm_fail(arm, "the reset vector is %08lXh, where no program is", (unsigned long)entry);
    }
}

void arm_call_begin(arm_t *arm, uint32_t function)
{
    arm_state_t *s = &arm->state;
    s->r[ARM_SP] = (s->r[ARM_SP] - 64u) & ~7u;
    s->r[ARM_LR] = ARM_CALL_RETURN | 1u;
    s->pc = function & ~1u;
    s->it = 0;
    s->sleeping = 0;
}

/* ---- priorities ----------------------------------------------------------------------------------------------------- */

static bool get(const uint32_t *bits, unsigned n) { return (bits[n / 32u] >> (n % 32u) & 1u) != 0u; }

static void set(uint32_t *bits, unsigned n, bool on)
{
    const uint32_t bit = UINT32_C(1) << (n % 32u);
    bits[n / 32u] = on ? bits[n / 32u] | bit : bits[n / 32u] & ~bit;
}

/* The most urgent of a set: the lowest priority number, the lower interrupt of two. Returns its priority. */
static uint32_t most_urgent(const arm_nvic_t *nvic, const uint32_t *first, const uint32_t *second, unsigned *interrupt)
{
    uint32_t best = LOWEST;
    for (unsigned word = 0; word < WORDS; word++) {
        uint32_t rest = first[word] & ((second != NULL) ? second[word] : 0xFFFFFFFFu);
        for (unsigned n = 32u * word; rest != 0u; rest >>= 1, n++) {
            if ((rest & 1u) != 0u && nvic->priority[n] < best) {
                best = nvic->priority[n];
                *interrupt = n;
            }
        }
    }
    return best;
}

/* Priority of what runs, raised by the masks. */
static uint32_t execution_priority(const arm_state_t *s)
{
    unsigned unused;
    uint32_t priority = most_urgent(&s->nvic, s->nvic.active, NULL, &unused);
    if (s->basepri != 0u && s->basepri < priority) {
        priority = s->basepri;
    }
    return (s->primask != 0u) ? 0u : priority;
}

void arm_request(arm_t *arm, unsigned first, uint64_t lines)
{
    arm_nvic_t *nvic = &arm->state.nvic;
    for (unsigned k = 0; k < 2u; k++) {
        const unsigned word = first / 32u + k;
        const uint32_t level = (uint32_t)(lines >> (32u * k));
        /* A line that becomes active is pending, also after it has become inactive again. */
        nvic->pending[word] |= level & ~nvic->line[word];
        nvic->line[word] = level;
    }
    arm->state.changed = 1;
}

/* ---- entry and return ----------------------------------------------------------------------------------------------- */

static bool push_frame(arm_t *arm)
{
    arm_state_t *s = &arm->state;
    const uint32_t moved = s->r[ARM_SP] & 4u;
    const uint32_t frame = s->r[ARM_SP] - moved - FRAME;
    const uint32_t word[8] = {s->r[0],  s->r[1],      s->r[2], s->r[3],
                              s->r[12], s->r[ARM_LR], s->pc,   arm_xpsr(arm) | (moved != 0u ? XPSR_ALIGNED : 0u)};
    for (unsigned k = 0; k < 8u; k++) {
        arm_store_slow(arm, frame + 4u * k, 4u, word[k]);
    }
    s->r[ARM_LR] = (s->exception != 0u) ? RETURN_HANDLER : RETURN_THREAD;
    s->r[ARM_SP] = frame;
    return !arm->failed;
}

/* With the frame already on the stack. */
static void start_handler(arm_t *arm, unsigned interrupt)
{
    arm_state_t *s = &arm->state;
    const uint32_t vector = arm_load_slow(arm, s->vtor + 4u * (FIRST + interrupt), 4u);
    set(s->nvic.pending, interrupt, false);
    set(s->nvic.active, interrupt, true);
    s->exception = FIRST + interrupt;
    s->it = 0;
    s->pc = vector & ~1u;
    s->sleeping = 0;
    if (arm_slot(arm, s->pc) == NULL || (vector & 1u) == 0u) {
        arm_fail(arm, "vector of interrupt %u is %08lXh, where no program is", interrupt, (unsigned long)vector);
        return;
    }
    if (arm->owner->entered != NULL) {
        arm->owner->entered(arm->self, interrupt);
    }
}

void arm_take_interrupt(arm_t *arm)
{
    arm_state_t *s = &arm->state;
    unsigned interrupt = 0;
    s->changed = 0;
    const uint32_t urgency = most_urgent(&s->nvic, s->nvic.pending, s->nvic.enabled, &interrupt);
    const uint32_t masked = s->primask;
    if (s->sleeping != 0u) { /* PRIMASK does not keep the core asleep */
        s->primask = 0;
        s->sleeping = (urgency < execution_priority(s)) ? 0u : 1u;
        s->primask = masked;
    }
    if (arm->failed || urgency >= execution_priority(s) || !push_frame(arm)) {
        return;
    }
    s->left -= (int32_t)CYCLES_ENTRY;
    start_handler(arm, interrupt);
}

void arm_exception_return(arm_t *arm, uint32_t code)
{
    arm_state_t *s = &arm->state;
    const unsigned interrupt = s->exception - FIRST;
    unsigned next = 0;
    set(s->nvic.active, interrupt, false);
    if (get(s->nvic.line, interrupt)) {
        set(s->nvic.pending, interrupt, true);
    }
    if (arm->owner->returned != NULL) {
        arm->owner->returned(arm->self, interrupt);
    }
    if (most_urgent(&s->nvic, s->nvic.pending, s->nvic.enabled, &next) < execution_priority(s)) {
        s->left -= (int32_t)CYCLES_TAIL_CHAIN;
        s->r[ARM_LR] = code;
        start_handler(arm, next);
        return;
    }
    if (code != RETURN_HANDLER && code != RETURN_THREAD) {
        arm_fail(arm, "return code %08lXh of an exception is not modelled", (unsigned long)code);
        return;
    }
    uint32_t word[8];
    for (unsigned k = 0; k < 8u; k++) {
        word[k] = arm_load_slow(arm, s->r[ARM_SP] + 4u * k, 4u);
    }
    s->r[0] = word[0];
    s->r[1] = word[1];
    s->r[2] = word[2];
    s->r[3] = word[3];
    s->r[12] = word[4];
    s->r[ARM_LR] = word[5];
    s->pc = word[6] & ~1u;
    s->r[ARM_SP] += FRAME + ((word[7] & XPSR_ALIGNED) != 0u ? 4u : 0u);
    arm_set_flags(arm, word[7]);
    s->exception = word[7] & 0x1FFu;
    s->it = (word[7] >> 25 & 3u) | (word[7] >> 8 & 0xFCu);
    s->left -= (int32_t)CYCLES_RETURN;
    if ((s->exception == 0u) != (code == RETURN_THREAD) || arm_slot(arm, s->pc) == NULL) {
        arm_fail(arm, "the frame of an exception is damaged: pc %08lXh", (unsigned long)word[6]);
    }
}

/* ---- system control space ------------------------------------------------------------------------------------------- */

#define ISER 0xE000E100u
#define IPR 0xE000E400u
#define CPUID 0xE000ED00u
#define VTOR 0xE000ED08u
#define AIRCR 0xE000ED0Cu
#define AIRCR_KEY 0x05FA0000u
#define AIRCR_SYSRESETREQ 4u
#define CPACR 0xE000ED88u

/* Groups of registers with a bit per interrupt, 0x80 apart. */
typedef enum { SET_ENABLED, CLEAR_ENABLED, SET_PENDING, CLEAR_PENDING, ACTIVE, BIT_GROUPS } bit_group_t;

static bool is_bits(uint32_t address, bit_group_t *group, unsigned *word)
{
    const uint32_t at = address - ISER;
    *group = (bit_group_t)(at / 0x80u);
    *word = at % 0x80u / 4u;
    return address >= ISER && at < 0x80u * BIT_GROUPS && *word < WORDS;
}

static bool is_priority(uint32_t address) { return address >= IPR && address < IPR + ARM_INTERRUPTS; }

bool arm_scs_read(arm_t *arm, uint32_t address, uint32_t *value)
{
    const arm_nvic_t *nvic = &arm->state.nvic;
    bit_group_t group;
    unsigned word;
    if (is_bits(address, &group, &word)) {
        *value = (group <= CLEAR_ENABLED)   ? nvic->enabled[word]
                 : (group <= CLEAR_PENDING) ? nvic->pending[word]
                                            : nvic->active[word];
    } else if (is_priority(address)) {
        const uint8_t *priority = &nvic->priority[address - IPR];
        *value = (uint32_t)priority[0] | (uint32_t)priority[1] << 8 | (uint32_t)priority[2] << 16 |
                 (uint32_t)priority[3] << 24;
    } else if (address == CPUID) {
        *value = 0x410FC241u;
    } else if (address == VTOR) {
        *value = arm->state.vtor;
    } else if (address == AIRCR) {
        *value = 0xFA050000u;
    } else if (address == CPACR) {
        *value = 0; /* no floating point */
    } else {
        return false;
    }
    return true;
}

static void write_bits(arm_nvic_t *nvic, bit_group_t group, unsigned word, uint32_t value)
{
    switch (group) {
    case SET_ENABLED:
        nvic->enabled[word] |= value;
        break;
    case CLEAR_ENABLED:
        nvic->enabled[word] &= ~value;
        break;
    case SET_PENDING:
        nvic->pending[word] |= value;
        break;
    case CLEAR_PENDING: /* an active line is pending again */
        nvic->pending[word] = (nvic->pending[word] & ~value) | (nvic->line[word] & ~nvic->active[word]);
        break;
    default: /* IABR is read only */
        break;
    }
}

bool arm_scs_write(arm_t *arm, uint32_t address, uint32_t value)
{
    arm_nvic_t *nvic = &arm->state.nvic;
    bit_group_t group;
    unsigned word;
    arm->state.changed = 1;
    arm_end_run(arm);
    if (is_bits(address, &group, &word)) {
        write_bits(nvic, group, word, value);
    } else if (is_priority(address)) {
        for (unsigned k = 0; k < 4u; k++) {
            nvic->priority[address - IPR + k] = (uint8_t)(value >> (8u * k) & PRIORITY_MASK);
        }
    } else if (address == VTOR && value % 512u == 0u) {
        arm->state.vtor = value;
    } else if (address == AIRCR && value == (AIRCR_KEY | AIRCR_SYSRESETREQ)) {
        arm->owner->reset(arm->self);
    } else {
        return false;
    }
    return true;
}
