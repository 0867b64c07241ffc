/* home_data.h - configuration and state of homing (homing.h). */
#ifndef SERVO_DRIVE_HOME_DATA_H
#define SERVO_DRIVE_HOME_DATA_H

#include "math/frac.h"

typedef struct {
    frac16_t speed;      /* speed of the first approach, Q1.15 of full-scale speed */
    frac16_t current;    /* limit of i_q during homing, Q1.15 of full-scale current */
    uint16_t back_off; /* back-off distance, counts */
    uint16_t spread_max; /* largest spread of the found positions of the reference, counts */
    uint16_t turns_max; /* largest distance to the reference, turns */
    uint16_t reach; /* permitted distance from the position at enabling while not homed, counts */
} home_config_t;

typedef struct {
    uint16_t state;  /* home_state_t */
    uint16_t method; /* home_method_t, requested or in progress */
    uint16_t result; /* home_result_t */
    uint16_t leg; /* LEG_ of homing.c */
    uint16_t ticks; /* slow ticks of standstill */
    uint16_t timeout; /* remaining time of the leg, units of 64 slow ticks */
    uint16_t spread; /* spread of the found positions of the reference, counts */
    uint16_t limit; /* LIMIT_ bit that reports the position limits in force */
    uint16_t refused_limit; /* LIMIT_ bit of a refused set-point; 0: none */
    bool limits_stale; /* limits must be recalculated because the state has changed */
    int32_t value; /* requested position of the reference, counts */
    int32_t origin; /* position at the start of the leg, otherwise at enabling, counts */
    int32_t rest_position; /* position of the standstill, counts */
    int32_t lowest; /* lowest found position of the reference, counts */
} home_t;

#endif
