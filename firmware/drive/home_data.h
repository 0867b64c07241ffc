/* home_data.h - whether the position of an axis is known, and how it is found. */
#ifndef SERVO_DRIVE_HOME_DATA_H
#define SERVO_DRIVE_HOME_DATA_H

#include "math/frac.h"

typedef struct {
    frac16_t speed;      /* of the first approach */
    frac16_t current;    /* limit of i_q meanwhile */
    uint16_t back_off;   /* counts */
    uint16_t spread_max; /* of the places where the reference was found, counts */
    uint16_t turns_max;  /* to the reference */
    uint16_t reach;      /* counts from where the axis was enabled, until its position is known */
} home_config_t;

typedef struct {
    uint16_t state;  /* home_state_t */
    uint16_t method; /* home_method_t that is asked for, or in progress */
    uint16_t result; /* home_result_t */
    uint16_t leg;    /* of a homing (homing.c) */
    uint16_t ticks;  /* slow ticks that the shaft stands */
    uint16_t timeout;   /* time until the leg has failed, 64 slow ticks */
    uint16_t spread; /* of the places where the reference was found, counts */
    uint16_t limit;  /* LIMIT_ bit of the position limits in force */
    uint16_t refused_limit; /* LIMIT_ bit of a set-point that was refused; 0: none */
    bool limits_stale;      /* the limits in force do not fit the state yet */
    int32_t value;   /* position that is asked for */
    int32_t origin;  /* where the leg has begun; where the axis was enabled */
    int32_t rest_position;  /* where the shaft stands */
    int32_t lowest;  /* place where the reference was found */
} home_t;

#endif
