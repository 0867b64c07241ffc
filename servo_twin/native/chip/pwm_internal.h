/* pwm_internal.h - what the three files of the PWM share. */
#ifndef CHIP_PWM_INTERNAL_H
#define CHIP_PWM_INTERNAL_H

#include "chip/pwm.h"

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

/* Registers of a module, in the order of their addresses. */
enum { OUTEN, MASK, SWCOUT, DTSRCSEL, MCTRL, MCTRL2, FCTRL0, FSTS0, FFILT0, FTST0, FCTRL1, FSTS1, FFILT1, FTST1 };

static inline pwm_module_t *module_of(pwm_t *pwm, const pwm_submodule_t *s) { return &pwm->module[s->module]; }

/* ---- counters and compares (pwm.c) ---------------------------------------------------------------------------------- */

uint16_t pwm_counter(const pwm_submodule_t *s, uint64_t now);

/* Flags of the compares up to the present clock. */
void pwm_settle(const pwm_t *pwm, pwm_submodule_t *s);

/* Which compares are events; after a change of what they do. */
void pwm_select_events(pwm_t *pwm, pwm_submodule_t *s);

/* Plan the next event; after a change of its clock. */
void pwm_schedule(pwm_t *pwm, pwm_submodule_t *s);

/* Requests of interrupts; after a change of flags or enables. */
void pwm_request(pwm_t *pwm, pwm_submodule_t *s);
void pwm_request_fault(pwm_t *pwm, unsigned m);

void pwm_load(pwm_t *pwm, pwm_submodule_t *s);

/* The counter begins anew from INIT in the present clock. */
void pwm_begin_cycle(pwm_t *pwm, pwm_submodule_t *s);

/* Submodule n counts while its RUN bit, or that of submodule 0 with whose clock it runs, and its gate are open. */
void pwm_follow_run(pwm_t *pwm, unsigned m);

/* ---- outputs and faults (pwm_outputs.c) ------------------------------------------------------------------------------ */

/* Which pins of a pair follow its outputs. */
void pwm_find_live_pins(pwm_t *pwm, pwm_submodule_t *s);
void pwm_update_all_pins(pwm_t *pwm, unsigned m);

/* Apply the outputs to the pins. */
static inline void pwm_update_pins(pwm_t *pwm, pwm_submodule_t *s)
{
    const unsigned levels = (s->out & s->live) ^ s->fixed;
    if (levels != s->levels) {
        s->levels = levels;
        bus_note(pwm->bus, TRACE_GATES, s->id, levels);
        bus_sync_plant(pwm->bus);
        pwm->bus->environment->set_gates(pwm->bus->board, s->module, s->number, levels);
    }
}

/* The dead-time unit of a pair: the switch that closes is delayed by its count, the other one opens at once. */
static inline void pwm_drive_pair(const pwm_t *pwm, pwm_submodule_t *s, bool pair)
{
    if (pair != s->pair || (s->out == 0 && s->dead_clock == CHIP_NEVER)) {
        s->pair = pair;
        const unsigned dead = s->dtcnt[pair ? 0 : 1];
        s->out = (dead > 0) ? 0u : pair ? 1u : 2u;
        s->dead_clock = (dead > 0) ? pwm->bus->now + dead : CHIP_NEVER;
    }
}

/* The dead time in progress is over. */
static inline void pwm_end_dead_time(pwm_submodule_t *s)
{
    s->dead_clock = CHIP_NEVER;
    s->out |= s->pair ? 1u : 2u;
}

/* The outputs; after a change of their inputs. */
void pwm_drive(pwm_t *pwm, pwm_submodule_t *s);

void pwm_force_out(pwm_t *pwm, pwm_submodule_t *s);

/* At a full or half cycle outputs resume that a fault has disabled. */
void pwm_resume_blocked(pwm_t *pwm, pwm_submodule_t *s, uint16_t boundary);

static inline void pwm_resume(pwm_t *pwm, pwm_submodule_t *s, uint16_t boundary)
{
    if (s->blocked != 0) {
        pwm_resume_blocked(pwm, s, boundary);
    }
}

void pwm_find_faults(pwm_t *pwm, unsigned m);

#endif
