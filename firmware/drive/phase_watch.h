/* phase_watch.h - phases that carry no current, and current converters that say what cannot be.
 *
 * A lost phase is silent while the others are not: at rest although current is asked of it, turning often and in every
 * direction of the rotor. A converter is broken when it says at the centre of the high side, where its shunt carries
 * nothing, that there is current, or the same code again and again while its neighbours show noise.
 */
#ifndef SERVO_DRIVE_PHASE_WATCH_H
#define SERVO_DRIVE_PHASE_WATCH_H

#include "drive/current_sense.h"
#include "drive/faults.h"

typedef struct {
    frac16_t silent;      /* less is no current */
    frac16_t least;       /* largest phase current from which on the directions of silence are noted */
    gain_t resistance;    /* full-scale current over full-scale voltage */
    gain_t inductance;    /* the same for a current that changes by that within a slow tick */
    frac16_t emf_floor;   /* voltage that switches and dead time leave unexplained */
    int32_t turn_per_voltage; /* of a rotor within a slow tick, for its back-EMF at full scale, 2^16 is a turn */
} phase_watch_config_t;

typedef struct {
    uint16_t silent[SENSE_PHASES];  /* slow ticks without the current that is asked for */
    uint16_t sectors[SENSE_PHASES]; /* eighths of an electrical turn in which it was silent, a bit each; how often */
    frac16_t wanted;                /* i_q* of the last slow tick */
    uint16_t carried;               /* phases that have carried current since somebody wanted to know, a bit each */
    uint16_t faint;                 /* recent slow ticks with too little current for that */
    bool lost;                      /* one of them is */
    uint16_t age;                   /* slow ticks */
    uint16_t nothing;               /* slow ticks in a row in which the current did not follow the voltage .. */
    uint16_t missed;                /* .. and of late, in a row or not */
    uint16_t wrong[SENSE_PHASES];   /* samples without current that are off the offset */
    uint16_t last[SENSE_PHASES];    /* the code before .. */
    uint16_t same[SENSE_PHASES];    /* .. and how often it has come again */
    uint16_t samples[SENSE_PHASES]; /* of the present window */
    uint16_t least[SENSE_PHASES];
    uint16_t most[SENSE_PHASES];
    bool noisy[SENSE_PHASES];       /* in the last whole window */
} phase_watch_t;

struct axis;

void phase_watch_start(phase_watch_t *watch);

/* A new attempt: what is known of the phases is forgotten, what is known of the converters is not. */
void phase_watch_restart(phase_watch_t *watch);

/* One slow tick with the codes without current that have just been taken; in every state. */
fault_set_t phase_watch_converters(struct axis *axis, adc_pair_t codes);

/* One slow tick of current control with the d axis at `theta_e`. */
fault_set_t phase_watch_currents(struct axis *axis, frac16_t theta_e);

/* `fault`, or CURRENT_SENSE while a converter looks wrong: then nothing else can be believed. Who does not want to know of
 * converters is told `fault`. */
fault_set_t phase_watch_or(const struct axis *axis, fault_set_t fault);

/* `fault`, or what is already suspected to be its cause: a converter or a phase. */
fault_set_t phase_watch_rather(const struct axis *axis, fault_set_t fault);

/* Does every phase carry current? Not at once, so from some moment on. */
static inline void phase_watch_forget_currents(phase_watch_t *watch) { watch->carried = 0; }

static inline bool phase_watch_all_carry(const phase_watch_t *watch)
{
    return watch->carried == (UINT16_C(1) << SENSE_PHASES) - 1U;
}

/* What an over-current may really have been. */
fault_set_t phase_watch_suspects(const phase_watch_t *watch);

#endif
