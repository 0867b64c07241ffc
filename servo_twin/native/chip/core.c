#include "chip/core.h"

#include "chip/parts.h"

#define IPR_FIRST 0xE300u
#define VBA 0xE30Du
#define FIM0 0xE30Eu
#define IRQP0 0xE314u
#define INTC_CTRL 0xE31Bu
#define INTC_CTRL_INT_DIS 0x0020u

#define LEVEL_BACKGROUND (-1)

void core_reset(chip_t *chip) { chip->core = (core_t){.masked = true, .changed = true, .access_clocks = 4}; }

/* ---- interrupt controller ----------------------------------------------------------------------------------------- */

/* Peripherals have their fields in the order of their vectors; code c is level c - 1 from the timers on. */
static void enable_vectors(chip_t *chip)
{
    core_t *core = &chip->core;
    for (int level = 0; level < CORE_LEVELS; level++) {
        core->enabled[level][0] = core->enabled[level][1] = 0;
    }
    for (unsigned vector = VECTOR_TMRB3; vector <= VECTOR_COP; vector++) {
        const unsigned index = vector - 9u;
        const unsigned code = (core->ipr[index / 8u] >> (2u * (index % 8u))) & 3u;
        if (code > 0) {
            core->enabled[code - 1u][vector >> 6] |= UINT64_C(1) << (vector & 63u);
        }
    }
    core->changed = true;
}

uint16_t intc_read(chip_t *chip, uint32_t address)
{
    const core_t *core = &chip->core;
    if (address < VBA) {
        return core->ipr[address - IPR_FIRST];
    }
    if (address == VBA) {
        return core->vba;
    }
    if (address >= IRQP0 && address < INTC_CTRL) {
        const unsigned first = (address - IRQP0) * 16u;
        uint16_t pending = 0xFFFF; /* active low */
        for (unsigned bit = 0; bit < 16u && first + bit < CORE_VECTORS; bit++) {
            const unsigned vector = first + bit;
            if (((core->request[vector >> 6] >> (vector & 63u)) & 1u) != 0) {
                pending = (uint16_t)(pending & ~(1u << bit));
            }
        }
        return pending;
    }
    if (address == INTC_CTRL) {
        return core->ctrl;
    }
    chip_no_register(chip, address);
}

void intc_write(chip_t *chip, uint32_t address, uint16_t value)
{
    core_t *core = &chip->core;
    if (address < VBA) {
        core->ipr[address - IPR_FIRST] = value;
        enable_vectors(chip);
    } else if (address == VBA) {
        core->vba = value & 0x1FFFu;
    } else if (address >= FIM0 && address < IRQP0) {
        chip_only(chip, address, value, 0, "fast interrupts are not modelled");
    } else if (address == INTC_CTRL) {
        core->ctrl = value & INTC_CTRL_INT_DIS;
        core->changed = true;
    } else {
        chip_no_register(chip, address);
    }
}

/* Most urgent request above `level`; the lower vector of two at one level. */
static bool most_urgent(const core_t *core, int level, unsigned *vector, int *its_level)
{
    for (int l = CORE_LEVELS - 1; l > level; l--) {
        for (unsigned word = 0; word < 2u; word++) {
            const uint64_t pending = core->request[word] & core->enabled[l][word];
            if (pending != 0) {
                *vector = 64u * word + chip_lowest_bit(pending);
                *its_level = l;
                return true;
            }
        }
    }
    return false;
}

/* ---- the core's time ---------------------------------------------------------------------------------------------- */

static void schedule(chip_t *chip)
{
    const core_t *core = &chip->core;
    chip_schedule(chip, SOURCE_CORE, (core->depth > 0) ? core->frame[core->depth - 1].end_clock : CHIP_NEVER);
}

CHIP_APART static void start(chip_t *chip, unsigned vector, int level)
{
    core_t *core = &chip->core;
    core_frame_t *frame = &core->frame[core->depth++];
    *frame = (core_frame_t){.vector = vector, .level = level, .end_clock = 0, .deferred = core->deferred_count};
    chip_note(chip, TRACE_ENTER, vector, (uint32_t)level);
    chip->pins.written = 0;
    const bool outer = core->deferring;
    core->deferring = true;
    const uint32_t clocks = world_interrupt(chip->world, vector);
    core->deferring = outer;
    const uint64_t length = (clocks > 0) ? clocks : 1u;
    frame->end_clock = chip->now + length;
    for (int i = 0; i < core->depth - 1; i++) {
        core->frame[i].end_clock += length; /* what it has interrupted goes on later */
    }
    core->changed = true;
    schedule(chip);
}

CHIP_APART static void look_for_requests(chip_t *chip)
{
    core_t *core = &chip->core;
    while (core->changed) {
        core->changed = false;
        if (core->booting || core->masked || (core->ctrl & INTC_CTRL_INT_DIS) != 0) {
            break;
        }
        const int level = (core->depth > 0) ? core->frame[core->depth - 1].level : LEVEL_BACKGROUND;
        unsigned vector;
        int its_level;
        if (most_urgent(core, level, &vector, &its_level)) {
            start(chip, vector, its_level);
        }
    }
}

static inline void start_handlers(chip_t *chip)
{
    if (chip->core.changed) {
        look_for_requests(chip);
    }
}

CHIP_APART static void run_background(chip_t *chip)
{
    chip->core.background_due = false;
    world_background(chip->world);
    start_handlers(chip);
    chip->core.changed = chip->core.background_due; /* it has woken itself */
}

void core_step(chip_t *chip)
{
    const core_t *core = &chip->core;
    start_handlers(chip);
    if (core->background_due && core->depth == 0 && !core->booting) {
        run_background(chip);
    }
}

void core_event(chip_t *chip)
{
    core_t *core = &chip->core;
    const core_frame_t frame = core->frame[core->depth - 1];
    for (unsigned i = frame.deferred; i < core->deferred_count; i++) {
        const uint32_t address = core->deferred[i].address;
        const uint16_t value = core->deferred[i].value;
        chip_note(chip, TRACE_WRITE, address, value);
        if (address >= 0xE600u) {
            pwm_write(chip, address, value);
        } else {
            gpio_write(chip, address, value);
        }
    }
    core->deferred_count = frame.deferred;
    core->depth--;
    chip_note(chip, TRACE_LEAVE, frame.vector, 0);
    core_wake(chip);
    schedule(chip);
}

/* ---- last acts of a handler ----------------------------------------------------------------------------------------- */

bool core_acts_last(const chip_t *chip, uint32_t address)
{
    if (address >= 0xE600u && address < 0xE800u) {
        return pwm_buffers(address);
    }
    if (address >= 0xE200u && address < 0xE270u && (address & 0xFu) == 1u) {
        return ((chip->pins.written >> ((address - 0xE200u) >> 4)) & 1u) != 0;
    }
    return false;
}

void core_defer(chip_t *chip, uint32_t address, uint16_t value)
{
    core_t *core = &chip->core;
    if (core->deferred_count == CORE_DEFERRED) {
        chip_fail(chip, "a handler writes more than %d buffered registers", CORE_DEFERRED);
    }
    core->deferred[core->deferred_count].address = address;
    core->deferred[core->deferred_count++].value = value;
}

const uint16_t *core_find_deferred(const chip_t *chip, uint32_t address)
{
    const core_t *core = &chip->core;
    if (core->depth > 0 && core->deferring) {
        for (unsigned i = core->deferred_count; i > core->frame[core->depth - 1].deferred; i--) {
            if (core->deferred[i - 1u].address == address) {
                return &core->deferred[i - 1u].value;
            }
        }
    }
    return NULL;
}
