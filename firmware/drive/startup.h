/* startup.h - from rest to a speed at which the observer sees the rotor (ST slides "起动策略", "起动成功的判据").
 *
 * First the windings are kept without current: the back-EMF of a shaft that turns shows then, and it is caught as it is.
 * But dead time and drops keep a current away that is meant to flow, so what seems to be back-EMF may be the echo of the
 * voltage that holds it off. A current along the rotor tells: with it echoes end.
 * A shaft that rests is drawn along by a current vector whose length and frequency follow ramps. The rotor swings about
 * the vector like a pendulum with hardly any friction; the back-EMF across the vector tells how fast, and a current across
 * it takes the swing away.
 */
#ifndef SERVO_DRIVE_STARTUP_H
#define SERVO_DRIVE_STARTUP_H

#include "control/transforms.h"
#include "drive/faults.h"

struct axis;

typedef struct {
    frac16_t first_current; /* FIRST_I_STARTUP */
    frac16_t final_current; /* FINAL_I_STARTUP */
    frac32_t current_step; /* per slow tick: (final - first) / I_START_UP_DURATION; may be negative */
    frac32_t final_speed; /* FINAL_START_UP_SPEED */
    frac32_t speed_step; /* per slow tick: final speed / FREQ_START_UP_DURATION */
    uint16_t duration_ticks; /* START_UP_DURATION, slow ticks */
    uint16_t tests; /* NB_CONSECUTIVE_TESTS */
    frac32_t minimum_speed; /* MINIMUM_SPEED_RPM */
    uint16_t mean_least; /* mean observed speed over the forced one, 14 fraction bits: the slide's 0.8 .. */
    uint16_t mean_most; /* .. and the tolerance of its upper bound, which the mean would only just meet */
    gain_t damping; /* current across the vector per back-EMF across it, of full scales */
    frac16_t damping_limit;
    uint16_t catch_ticks; /* slow ticks in which the back-EMF of a turning shaft shows */
    frac32_t fade_step; /* current per slow tick: what is left of the vector after the hand-over */
} startup_config_t;

typedef enum {
    STARTUP_CATCH, /* no current: does the shaft turn? */
    STARTUP_TRACK, /* it seems so, and the PLL locks */
    STARTUP_PROVE, /* a current along the rotor: does the back-EMF stay? */
    STARTUP_RAMP,
} startup_phase_t;

typedef struct {
    startup_phase_t phase;
    uint16_t ticks; /* slow ticks in this phase */
    uint16_t passed; /* tests of the criterion in a row */
    bool backwards;
    uint32_t angle; /* of the vector at the next sample, 2^32 is a turn */
    int32_t step; /* per PWM period */
    frac32_t speed; /* mechanical, of the vector; without sign */
    frac32_t current; /* length of the vector */
    ab_t emf; /* back-EMF of the last slow tick */
    frac32_t fade; /* i_d while the rotor is proved, and what is left of it after the hand-over */
} startup_t;

typedef enum {
    STARTUP_RUNS,
    STARTUP_DONE, /* the observer has the rotor */
    STARTUP_FAILED,
} startup_result_t;

/* Begin in the direction of a set-point. */
void startup_begin(struct axis *axis, bool backwards);

/* One PWM period: the current loop in its frame, and the observer. */
void startup_fast(struct axis *axis);

/* One slow tick. */
startup_result_t startup_slow(struct axis *axis);

/* A start-up that has failed: because no current flows, or for another reason. */
fault_set_t startup_failure(const struct axis *axis);

/* The rotor is taken over from the vector: currents and voltages stay what they are. */
void startup_hand_over(struct axis *axis);

/* What is left of the vector along the rotor, one slow tick later. */
frac16_t startup_fade(struct axis *axis);

#endif
