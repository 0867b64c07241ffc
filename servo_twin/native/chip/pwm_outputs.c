/* pwm_outputs.c - from the compares to the pins: dead time, polarity, forced values, faults. */
#include "chip/pwm_internal.h"

/* ---- outputs ------------------------------------------------------------------------------------------------------- */

/* Which pins of a pair follow its outputs. One that is not driven is held low by the resistor of its gate driver. */
void pwm_find_live_pins(pwm_t *pwm, pwm_submodule_t *s)
{
    const pwm_module_t *module = module_of(pwm, s);
    unsigned live = 0, high = 0, inverted = 0;
    for (unsigned side = 0; side < 2u; side++) {
        const unsigned bit = 1u << side;
        const unsigned map = (side == 0) ? s->dismap0 : (unsigned)s->dismap0 >> 4;
        const unsigned on_fault = (side == 0) ? OCTRL_PWMAFS(s->octrl) : OCTRL_PWMBFS(s->octrl);
        if (s->pin[side] != GATE_PWM) {
            high |= (s->pin[side] == GATE_HIGH) ? bit : 0u;
        } else if (((module->reg[OUTEN] >> (((side == 0) ? 8u : 4u) + s->number)) & 1u) == 0) {
            continue;
        } else if ((s->blocked & map & 0xFu) != 0) {
            high |= (on_fault == 1u) ? bit : 0u;
        } else {
            live |= bit;
            inverted |= ((s->octrl & ((side == 0) ? OCTRL_POLA : OCTRL_POLB)) != 0) ? bit : 0u;
        }
    }
    s->live = live & ~s->mask;
    s->fixed = inverted | high;
}

void pwm_update_all_pins(pwm_t *pwm, unsigned m)
{
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        pwm_find_live_pins(pwm, &pwm->module[m].sub[n]);
        pwm_update_pins(pwm, &pwm->module[m].sub[n]);
    }
}

void pwm_pins_changed(pwm_t *pwm)
{
    pwm_update_all_pins(pwm, 0);
    pwm_update_all_pins(pwm, 1);
}

void pwm_drive(pwm_t *pwm, pwm_submodule_t *s)
{
    const unsigned selected = (s->generated & s->followed) ^ s->given;
    if ((s->ctrl2 & CTRL2_INDEP) != 0) {
        s->out = selected;
        s->dead_clock = CHIP_NEVER;
    } else {
        pwm_drive_pair(pwm, s, s->from_45 ? (selected & 2u) == 0 : (selected & 1u) != 0);
    }
    pwm_update_pins(pwm, s);
}

void pwm_force_out(pwm_t *pwm, pwm_submodule_t *s)
{
    const pwm_module_t *module = module_of(pwm, s);
    const unsigned n = s->number;
    s->followed = s->given = 0;
    for (unsigned which = 0; which < 2u; which++) { /* PWM23 and PWM45: 0 generated, 1 inverted, 2 software */
        const unsigned source = (module->reg[DTSRCSEL] >> (4u * n + 2u - 2u * which)) & 3u;
        const unsigned software = (module->reg[SWCOUT] >> (2u * n + 1u - which)) & 1u;
        s->followed |= (source != 2u ? 1u : 0u) << which;
        s->given |= (source == 2u ? software : source) << which;
    }
    s->mask = ((module->reg[MASK] >> (8u + n)) & 1u) | (((module->reg[MASK] >> (4u + n)) & 1u) << 1);
    pwm_find_live_pins(pwm, s);
    pwm_drive(pwm, s);
}

/* ---- faults ---------------------------------------------------------------------------------------------------------- */

static bool may_resume(const pwm_module_t *module, unsigned i)
{
    const bool active = ((module->fault_active >> i) & 1u) != 0;
    if (FCTRL_FAUTO(module->reg[FCTRL0], i) != 0) {
        return !active;
    }
    const bool flag = ((module->fault_flag >> i) & 1u) != 0;
    return !flag && !(FCTRL_FSAFE(module->reg[FCTRL0], i) != 0 && active);
}

void pwm_resume_blocked(pwm_t *pwm, pwm_submodule_t *s, uint16_t boundary)
{
    const pwm_module_t *module = module_of(pwm, s);
    const unsigned before = s->blocked;
    for (unsigned i = 0; (s->blocked & boundary) != 0 && i < PWM_FAULTS; i++) {
        if (((s->blocked & boundary) >> i & 1u) != 0 && may_resume(module, i)) {
            s->blocked &= ~(1u << i);
        }
    }
    if (s->blocked != before) {
        pwm_select_events(pwm, s);
        pwm_find_live_pins(pwm, s);
        pwm_update_pins(pwm, s);
    }
}

void pwm_find_faults(pwm_t *pwm, unsigned m)
{
    pwm_module_t *module = &pwm->module[m];
    const unsigned simulated = ((module->reg[FTST0] & 1u) != 0) ? 0xFu : 0u;
    const unsigned active = ((module->fault_filtered ^ ~FCTRL_FLVL(module->reg[FCTRL0])) & 0xFu) | simulated;
    const unsigned begun = active & ~module->fault_active;
    module->fault_active = active;
    if (begun == 0) {
        return;
    }
    module->fault_flag |= begun;
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        pwm_submodule_t *s = &module->sub[n];
        s->blocked |= begun;
        pwm_select_events(pwm, s);
        pwm_find_live_pins(pwm, s);
        pwm_update_pins(pwm, s);
        pwm_schedule(pwm, s);
    }
    pwm_request_fault(pwm, m);
}

static void schedule_fault(pwm_t *pwm)
{
    uint64_t next = CHIP_NEVER;
    for (unsigned i = 0; i < PWM_MODULES * PWM_FAULTS; i++) {
        const uint64_t clock = pwm->module[i / PWM_FAULTS].fault_clock[i % PWM_FAULTS];
        next = (clock < next) ? clock : next;
    }
    bus_plan(pwm->bus, SOURCE_FAULT, next);
}

void pwm_fault_event(void *peripheral, unsigned source)
{
    pwm_t *pwm = (pwm_t *)peripheral;
    (void)source;
    for (unsigned m = 0; m < PWM_MODULES; m++) {
        pwm_module_t *module = &pwm->module[m];
        for (unsigned i = 0; i < PWM_FAULTS; i++) {
            if (module->fault_clock[i] <= pwm->bus->now) {
                module->fault_clock[i] = CHIP_NEVER;
                module->fault_filtered ^= 1u << i;
            }
        }
        pwm_find_faults(pwm, m);
    }
    schedule_fault(pwm);
}

void pwm_fault_input(pwm_t *pwm, unsigned m, unsigned input, bool level)
{
    pwm_module_t *module = &pwm->module[m];
    const unsigned bit = 1u << input;
    if (((module->fault_pin & bit) != 0) == level) {
        return;
    }
    module->fault_pin ^= bit;
    const uint64_t delay = (uint64_t)(module->reg[FFILT0] & 0xFFu) * (((unsigned)module->reg[FFILT0] >> 8 & 7u) + 3u);
    const bool same = ((module->fault_filtered & bit) != 0) == level;
    module->fault_clock[input] = same ? CHIP_NEVER : pwm->bus->now + delay;
    schedule_fault(pwm);
    if (!same && delay == 0) {
        pwm_fault_event(pwm, SOURCE_FAULT);
    }
}
