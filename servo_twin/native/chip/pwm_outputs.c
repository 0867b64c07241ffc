/* pwm_outputs.c - from the compares to the pins: dead time, polarity, forced values, faults. */
#include "chip/pwm_parts.h"

/* ---- outputs ------------------------------------------------------------------------------------------------------- */

/* Which pins of a pair follow its outputs. One that is not driven is held low by the resistor of its gate driver. */
void pwm_prepare(chip_t *chip, pwm_submodule_t *s)
{
    const pwm_t *pwm = pwm_of(chip, s);
    const unsigned m = s->module;
    const unsigned n = s->number;
    unsigned live = 0, high = 0, inverted = 0;
    for (unsigned side = 0; n < 3u && side < 2u; side++) {
        const unsigned pin = chip->config.wiring.gate[m][n][side];
        const pin_function_t function = pins_function(chip, pin);
        const unsigned bit = 1u << side;
        const unsigned map = (side == 0) ? s->dismap0 : (unsigned)s->dismap0 >> 4;
        const unsigned on_fault = (side == 0) ? OCTRL_PWMAFS(s->octrl) : OCTRL_PWMBFS(s->octrl);
        if (function == FUNCTION_GPIO) {
            const gpio_port_t *port = &chip->pins.port[pin >> 4];
            high |= (((unsigned)(port->direction & port->data) >> (pin & 15u)) & 1u) << side;
        } else if (function != (pin_function_t)(FUNCTION_PWM_A0A + 8u * m + 2u * n + side) ||
                   ((pwm->outen >> (((side == 0) ? 8u : 4u) + n)) & 1u) == 0) {
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

void pwm_show_all(chip_t *chip, unsigned m)
{
    for (unsigned n = 0; n < PWM_SUBMODULES; n++) {
        pwm_prepare(chip, &chip->pwm[m].sub[n]);
        pwm_show(chip, &chip->pwm[m].sub[n]);
    }
}

void pwm_pins_changed(chip_t *chip)
{
    pwm_show_all(chip, 0);
    pwm_show_all(chip, 1);
}

void pwm_drive(chip_t *chip, pwm_submodule_t *s)
{
    const unsigned selected = (s->generated & s->followed) ^ s->given;
    if ((s->ctrl2 & CTRL2_INDEP) != 0) {
        s->out = selected;
        s->dead_clock = CHIP_NEVER;
    } else {
        pwm_drive_pair(chip, s, s->from_45 ? (selected & 2u) == 0 : (selected & 1u) != 0);
    }
    pwm_show(chip, s);
}

void pwm_force_out(chip_t *chip, pwm_submodule_t *s)
{
    const pwm_t *pwm = pwm_of(chip, s);
    const unsigned n = s->number;
    s->followed = s->given = 0;
    for (unsigned which = 0; which < 2u; which++) { /* PWM23 and PWM45: 0 generated, 1 inverted, 2 software */
        const unsigned source = (pwm->dtsrcsel >> (4u * n + 2u - 2u * which)) & 3u;
        const unsigned software = (pwm->swcout >> (2u * n + 1u - which)) & 1u;
        s->followed |= (source != 2u ? 1u : 0u) << which;
        s->given |= (source == 2u ? software : source) << which;
    }
    s->mask = ((pwm->mask >> (8u + n)) & 1u) | (((pwm->mask >> (4u + n)) & 1u) << 1);
    pwm_prepare(chip, s);
    pwm_drive(chip, s);
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

void pwm_resume_blocked(chip_t *chip, pwm_submodule_t *s, uint16_t boundary)
{
    const pwm_t *pwm = pwm_of(chip, s);
    const unsigned before = s->blocked;
    for (unsigned i = 0; (s->blocked & boundary) != 0 && i < PWM_FAULTS; i++) {
        if (((s->blocked & boundary) >> i & 1u) != 0 && may_resume(pwm, i)) {
            s->blocked &= ~(1u << i);
        }
    }
    if (s->blocked != before) {
        pwm_watch(chip, s);
        pwm_prepare(chip, s);
        pwm_show(chip, s);
    }
}

void pwm_find_faults(chip_t *chip, unsigned m)
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
        pwm_submodule_t *s = &pwm->sub[n];
        s->blocked |= begun;
        pwm_watch(chip, s);
        pwm_prepare(chip, s);
        pwm_show(chip, s);
        pwm_schedule(chip, s);
    }
    pwm_request_fault(chip, m);
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
        pwm_find_faults(chip, m);
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
