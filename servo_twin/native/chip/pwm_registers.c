/* pwm_registers.c - the registers, as the software reads and writes them. */
#include "chip/pwm_internal.h"

#define MODULE_SIZE 0x100u
#define SUB_SIZE 0x30u
#define SUB_REGISTERS (PWM_SUBMODULES * SUB_SIZE) /* those of the module follow */

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

/* Buffered registers by their offset in the module: 8 submodule + (1 INIT, 2-7 VAL0-5); 80h is MCTRL. */
#define BUFFERED_MCTRL 0x80u
#define BUFFERED(n)                                                                                                    \
    [(n) * SUB_SIZE + INIT] = 1 + 8 * (n), [(n) * SUB_SIZE + VAL0] = 2 + 8 * (n),                                      \
                      [(n) * SUB_SIZE + VAL0 + 2] = 3 + 8 * (n), [(n) * SUB_SIZE + VAL0 + 4] = 4 + 8 * (n),            \
                      [(n) * SUB_SIZE + VAL0 + 6] = 5 + 8 * (n), [(n) * SUB_SIZE + VAL0 + 8] = 6 + 8 * (n),            \
                      [(n) * SUB_SIZE + VAL5] = 7 + 8 * (n)

static const uint8_t buffered[MODULE_SIZE] = {BUFFERED(0), BUFFERED(1), BUFFERED(2), BUFFERED(3),
                                              [SUB_REGISTERS + MCTRL] = BUFFERED_MCTRL};

static bool is_value(uint32_t number)
{
    return number == INIT || (number >= VAL0 && number <= VAL5 && (number & 1u) != 0);
}

static bool is_fraction(uint32_t number) { return number >= FRACVAL1 && number < VAL5 && (number & 1u) == 0; }

static uint16_t read_sub(pwm_t *pwm, uint32_t address, unsigned m, unsigned n, uint32_t number)
{
    pwm_submodule_t *s = &pwm->module[m].sub[n];
    if (number == INIT) {
        return s->buffer.init;
    }
    if (is_value(number)) {
        return s->buffer.val[(number - VAL0) / 2u];
    }
    if (is_fraction(number)) {
        return 0;
    }
    switch (number) {
    case CNT:
        return pwm_counter(s, pwm->bus->now);
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
        pwm_settle(pwm, s);
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
        return s->dtcnt[number - DTCNT0];
    default:
        bus_no_register(pwm->bus, address);
    }
}

static void write_ctrl2(pwm_t *pwm, uint32_t address, unsigned m, unsigned n, uint16_t value)
{
    pwm_module_t *module = &pwm->module[m];
    pwm_submodule_t *s = &module->sub[n];
    const unsigned clock = CTRL2_CLK_SEL(value);
    const unsigned force = CTRL2_FORCE_SEL(value);
    const unsigned init = CTRL2_INIT_SEL(value);
    if (clock == 1u || clock == 3u || (n == 0 && clock != 0)) {
        bus_no_value(pwm->bus, address, value, "this CLK_SEL is not modelled");
    }
    if (n == 0 && ((value & CTRL2_RELOAD_SEL) != 0 || init == INIT_MASTER_RELOAD || init == INIT_MASTER_SYNC)) {
        bus_no_value(pwm->bus, address, value, "submodule 0 cannot follow itself");
    }
    if (init == INIT_MASTER_RELOAD || force == FORCE_MASTER_RELOAD || force > FORCE_MASTER_SYNC ||
        (n == 0 && (force & 1u) != 0)) {
        bus_no_value(pwm->bus, address, value, "this INIT_SEL or FORCE_SEL is not modelled");
    }
    s->ctrl2 = (uint16_t)(value & ~CTRL2_FORCE);
    pwm_select_events(pwm, s);
    pwm_follow_run(pwm, m);
    if ((value & CTRL2_FORCE) != 0) {
        for (unsigned k = n; k < PWM_SUBMODULES; k++) {
            pwm_submodule_t *other = &module->sub[k];
            const unsigned by = CTRL2_FORCE_SEL(other->ctrl2);
            if ((k != n || by != FORCE_LOCAL) && !(n == 0 && k > 0 && by == FORCE_MASTER)) {
                continue;
            }
            if ((other->ctrl2 & CTRL2_FRCEN) != 0) {
                other->generated = ((other->ctrl2 & CTRL2_PWM23_INIT) != 0 ? 1u : 0u) |
                                   ((other->ctrl2 & CTRL2_PWM45_INIT) != 0 ? 2u : 0u);
                if (other->running) {
                    pwm_settle(pwm, other);
                    pwm_begin_cycle(pwm, other);
                }
            }
            pwm_force_out(pwm, other);
            pwm_schedule(pwm, other);
        }
    }
    pwm_schedule(pwm, s);
}

static void write_sub(pwm_t *pwm, uint32_t address, unsigned m, unsigned n, uint32_t number, uint16_t value)
{
    pwm_module_t *module = &pwm->module[m];
    pwm_submodule_t *s = &module->sub[n];
    if (is_fraction(number)) {
        bus_allow(pwm->bus, address, value, 0, "the fractional unit is not modelled");
        return;
    }
    switch (number) {
    case CTRL2:
        write_ctrl2(pwm, address, m, n, value);
        break;
    case CTRL:
        bus_allow(pwm->bus, address, value, 0xFF74, "double switching is not modelled");
        s->ctrl = (uint16_t)(value & ~0x0300u);
        if (((module->ldok >> n) & 1u) == 0) {
            s->updated = s->updated || CTRL_PRSC(value) != s->buffer.prescaler;
            s->buffer.prescaler = CTRL_PRSC(value);
        }
        pwm_select_events(pwm, s);
        pwm_schedule(pwm, s);
        break;
    case FRCTRL:
        bus_allow(pwm->bus, address, value, 0, "the fractional unit is not modelled");
        break;
    case OCTRL:
        s->octrl = value & 0x073Fu;
        pwm_find_live_pins(pwm, s);
        pwm_update_pins(pwm, s);
        break;
    case STS:
        pwm_settle(pwm, s);
        s->flags = (uint16_t)(s->flags & ~value);
        pwm_request(pwm, s);
        break;
    case INTEN:
        bus_allow(pwm->bus, address, value, 0x303F, "the capture unit is not modelled");
        pwm_settle(pwm, s);
        s->inten = value;
        pwm_select_events(pwm, s);
        pwm_request(pwm, s);
        pwm_schedule(pwm, s);
        break;
    case DMAEN:
        bus_allow(pwm->bus, address, value, 0, "DMA is not modelled");
        break;
    case TCTRL:
        bus_allow(pwm->bus, address, value, 0x003F, "PWM waveforms as triggers are not modelled");
        s->tctrl = value;
        pwm_select_events(pwm, s);
        pwm_schedule(pwm, s);
        break;
    case DISMAP0:
        s->dismap0 = value;
        pwm_find_live_pins(pwm, s);
        pwm_update_pins(pwm, s);
        break;
    case DISMAP1: /* faults 4-7 have no pins here */
        s->dismap1 = value;
        break;
    case DTCNT0:
    case DTCNT1:
        s->dtcnt[number - DTCNT0] = value & 0x7FFu;
        break;
    default:
        bus_no_register(pwm->bus, address);
    }
}

static void write_mctrl(pwm_t *pwm, unsigned m, uint16_t value)
{
    pwm_module_t *module = &pwm->module[m];
    module->ldok = (uint16_t)((module->ldok | (value & 0xFu)) & ~((unsigned)value >> 4 & 0xFu));
    const bool same_run = module->run == ((value >> 8) & 0xFu);
    const uint16_t ipol = (uint16_t)(value >> 12);
    if (ipol != module->ipol) {
        module->ipol = ipol;
        for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
            pwm_select_events(pwm, &module->sub[n]);
        }
    }
    module->run = (value >> 8) & 0xFu;
    const bool first_stuck = module->sub[0].running && module->sub[0].stuck;
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        pwm_submodule_t *s = &module->sub[n];
        /* A counter whose cycle is one clock reloads in every clock, and so do its followers. */
        const bool led = first_stuck && n > 0 && (s->ctrl2 & CTRL2_RELOAD_SEL) != 0;
        const bool stuck = s->running && (s->stuck || led);
        if (((module->ldok >> n) & 1u) != 0 && ((s->ctrl & CTRL_LDMOD) != 0 || stuck)) {
            pwm_load(pwm, s);
            if (stuck) {
                pwm_begin_cycle(pwm, s);
            }
            pwm_schedule(pwm, s);
        }
    }
    if (!same_run) {
        pwm_follow_run(pwm, m);
    }
}

static uint16_t fault_status(const pwm_module_t *module)
{
    return (uint16_t)(module->fault_flag | (unsigned)module->fsts_full << 4 | module->fault_filtered << 8 |
                      (unsigned)module->fsts_half << 12);
}

static uint16_t read_module(pwm_t *pwm, uint32_t address, unsigned m, uint32_t number)
{
    const pwm_module_t *module = &pwm->module[m];
    if (number > FTST1) {
        bus_no_register(pwm->bus, address);
    }
    if (number == MCTRL) {
        return (uint16_t)(module->ldok | (unsigned)module->run << 8 | (unsigned)module->ipol << 12);
    }
    return (number == FSTS0) ? fault_status(module) : module->reg[number];
}

static void write_module(pwm_t *pwm, uint32_t address, unsigned m, uint32_t number, uint16_t value)
{
    pwm_module_t *module = &pwm->module[m];
    switch (number) {
    case OUTEN:
        bus_allow(pwm->bus, address, value, 0x0FF0, "PWM_X is not modelled");
        module->reg[OUTEN] = value;
        pwm_update_all_pins(pwm, m);
        break;
    case MASK:
        module->reg[MASK] = value & 0x0FFFu;
        break;
    case SWCOUT:
        module->reg[SWCOUT] = value & 0x00FFu;
        break;
    case DTSRCSEL:
        for (unsigned k = 0; k < 8u; k++) {
            if (((value >> (2u * k)) & 3u) == 3u) {
                bus_no_value(pwm->bus, address, value, "external sources are not modelled");
            }
        }
        module->reg[DTSRCSEL] = value;
        break;
    case MCTRL:
        write_mctrl(pwm, m, value);
        break;
    case MCTRL2:
        bus_allow(pwm->bus, address, value, 0x0003, "reserved");
        module->reg[MCTRL2] = value;
        break;
    case FCTRL0:
        module->reg[FCTRL0] = value;
        pwm_find_faults(pwm, m);
        pwm_request_fault(pwm, m);
        break;
    case FSTS0:
        module->fault_flag &= ~(unsigned)value;
        module->fsts_full = (value >> 4) & 0xFu;
        module->fsts_half = (uint16_t)(value >> 12);
        for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
            pwm_select_events(pwm, &module->sub[n]);
            pwm_schedule(pwm, &module->sub[n]);
        }
        pwm_request_fault(pwm, m);
        break;
    case FFILT0:
        bus_allow(pwm->bus, address, value, 0x87FF, "reserved");
        module->reg[FFILT0] = value;
        break;
    case FTST0:
        module->reg[FTST0] = value & 1u;
        pwm_find_faults(pwm, m);
        break;
    case FCTRL1:
        bus_allow(pwm->bus, address, value, 0xFFF0, "interrupts of the faults 4-7 are not modelled");
        module->reg[FCTRL1] = value;
        break;
    case FSTS1:
        module->reg[FSTS1] = value & 0xF0F0u;
        break;
    case FFILT1:
        module->reg[FFILT1] = value;
        break;
    case FTST1:
        bus_allow(pwm->bus, address, value, 0, "faults 4-7 are not modelled");
        break;
    default:
        bus_no_register(pwm->bus, address);
    }
}

static void check_gate(pwm_t *pwm, uint32_t address, unsigned m, uint32_t offset)
{
    const unsigned first = (m == 0) ? 7u : 3u;
    bus_check_gate(pwm->bus, address, 3, (offset < SUB_REGISTERS) ? first - offset / SUB_SIZE : first);
}

uint16_t pwm_read(void *peripheral, uint32_t address)
{
    pwm_t *pwm = (pwm_t *)peripheral;
    const unsigned m = (address - PWM_BASE) / MODULE_SIZE;
    const uint32_t offset = (address - PWM_BASE) % MODULE_SIZE;
    check_gate(pwm, address, m, offset);
    if (offset < SUB_REGISTERS) {
        return read_sub(pwm, address, m, offset / SUB_SIZE, offset % SUB_SIZE);
    }
    return read_module(pwm, address, m, offset - SUB_REGISTERS);
}

static void write_buffer(pwm_t *pwm, uint32_t address, unsigned m, unsigned entry, uint16_t value)
{
    pwm_module_t *module = &pwm->module[m];
    pwm_submodule_t *s = pwm->submodule[PWM_SUBMODULES * m + entry / 8u];
    bus_check_gate(pwm->bus, address, 3, 7u - s->id);
    if (((module->ldok >> s->number) & 1u) != 0) {
        module->locked_writes++;
        return;
    }
    if (entry % 8u == 1u) {
        s->buffer.init = value;
    } else {
        s->buffer.val[entry % 8u - 2u] = value;
    }
    s->updated = true;
}

NOINLINE static void write_plain(pwm_t *pwm, uint32_t address, uint16_t value)
{
    const unsigned m = (address - PWM_BASE) / MODULE_SIZE;
    const uint32_t offset = (address - PWM_BASE) % MODULE_SIZE;
    check_gate(pwm, address, m, offset);
    if (offset < SUB_REGISTERS) {
        write_sub(pwm, address, m, offset / SUB_SIZE, offset % SUB_SIZE, value);
    } else {
        write_module(pwm, address, m, offset - SUB_REGISTERS, value);
    }
}

void pwm_write(void *peripheral, uint32_t address, uint16_t value)
{
    pwm_t *pwm = (pwm_t *)peripheral;
    const unsigned entry = buffered[address % MODULE_SIZE];
    if (entry != 0 && entry != BUFFERED_MCTRL) {
        write_buffer(pwm, address, (address - PWM_BASE) / MODULE_SIZE, entry, value);
    } else {
        write_plain(pwm, address, value);
    }
}
