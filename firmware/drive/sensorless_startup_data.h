/* sensorless_startup_data.h - configuration and state of the sensorless start-up (sensorless_startup.h). */
#ifndef SERVO_DRIVE_SENSORLESS_STARTUP_DATA_H
#define SERVO_DRIVE_SENSORLESS_STARTUP_DATA_H

#include "control/transforms.h"

typedef struct {
    frac16_t first_current; /* FIRST_I_STARTUP */
    frac16_t final_current; /* FINAL_I_STARTUP */
    frac32_t current_step; /* per slow tick: (final - first) / I_START_UP_DURATION; may be negative */
    frac32_t final_speed; /* FINAL_START_UP_SPEED */
    frac32_t speed_step; /* per slow tick: final speed / FREQ_START_UP_DURATION */
    uint16_t duration_ticks; /* START_UP_DURATION, slow ticks */
    uint16_t tests; /* NB_CONSECUTIVE_TESTS */
    frac32_t minimum_speed; /* MINIMUM_SPEED_RPM */
    uint16_t mean_min; /* mean observed speed over the forced one, 14 fraction bits: the slide's 0.8 .. */
    uint16_t mean_max; /* .. and the tolerance of its upper bound, which the mean would only just reach */
    gain_t damping; /* current across the vector per back-EMF across it, of full scales */
    frac16_t damping_limit; /* Q1.15 of full-scale current */
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

#endif
