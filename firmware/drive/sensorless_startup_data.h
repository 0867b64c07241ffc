/* sensorless_startup_data.h - configuration and state of the sensorless start-up (sensorless_startup.h). */
#ifndef SERVO_DRIVE_SENSORLESS_STARTUP_DATA_H
#define SERVO_DRIVE_SENSORLESS_STARTUP_DATA_H

#include "control/transforms.h"

typedef struct {
    frac16_t first_current; /* FIRST_I_STARTUP, Q1.15 of full-scale current */
    frac16_t final_current; /* FINAL_I_STARTUP, Q1.15 of full-scale current */
    frac32_t current_step; /* change per slow tick: (final - first) / I_START_UP_DURATION; may be negative */
    frac32_t final_speed; /* FINAL_START_UP_SPEED */
    frac32_t speed_step; /* change of the speed per slow tick: final speed / FREQ_START_UP_DURATION */
    uint16_t duration_ticks; /* START_UP_DURATION, slow ticks */
    uint16_t tests; /* NB_CONSECUTIVE_TESTS */
    frac32_t minimum_speed; /* MINIMUM_SPEED_RPM */
    uint16_t mean_min; /* smallest mean observed speed / forced speed, 14 fraction bits (slide: 0.8) */
    uint16_t mean_max; /* largest mean observed speed / forced speed, 14 fraction bits: 1 plus a tolerance */
    gain_t damping; /* damping of the rotor oscillation: quadrature current / quadrature back-EMF, of full scales */
    frac16_t damping_limit; /* largest damping current, Q1.15 of full-scale current */
    uint16_t catch_ticks; /* duration of CATCH, slow ticks */
    frac32_t fade_step; /* change of i_d per slow tick in PROVE and after the hand-over, Q1.31 of full-scale current */
} startup_config_t;

typedef enum {
    STARTUP_CATCH, /* zero current: search for the back-EMF of a rotating shaft */
    STARTUP_TRACK, /* back-EMF found: the PLL locks */
    STARTUP_PROVE, /* i_d applied: only a true back-EMF remains */
    STARTUP_RAMP, /* current vector with ramped amplitude and frequency */
} startup_phase_t;

typedef struct {
    startup_phase_t phase;
    uint16_t ticks; /* slow ticks in this phase */
    uint16_t passed; /* consecutive passed tests of the criterion */
    bool backwards; /* negative speed set-point */
    uint32_t angle; /* electrical angle of the vector at the next sample, 2^32 is one turn */
    int32_t step; /* rotation of the vector per PWM period, 2^32 is one turn */
    frac32_t speed; /* mechanical speed of the vector, Q1.31 of full-scale speed: magnitude in RAMP, signed in TEST */
    frac32_t current; /* length of the vector, Q1.31 of full-scale current */
    ab_t emf; /* back-EMF of the last slow tick, Q1.15 of full-scale voltage */
    frac32_t i_d; /* i_d* in PROVE and after the hand-over, Q1.31 of full-scale current */
} startup_t;

#endif
