/* sensorless_estimate_data.h - what the observer and the PLL of an axis know. */
#ifndef SERVO_DRIVE_SENSORLESS_ESTIMATE_DATA_H
#define SERVO_DRIVE_SENSORLESS_ESTIMATE_DATA_H

#include "control/pll.h"
#include "sensing/emf_check.h"
#include "sensing/speed_reliability.h"

typedef struct {
    back_emf_observer_t observer;
    pll_t pll;
    speed_reliability_t reliability;
    emf_check_t check;
    ab_t emf;         /* in the last slow tick, stator frame */
    frac16_t size;    /* length of the back-EMF, Q1.15 of full-scale voltage */
    frac16_t expected_emf; /* back-EMF that belongs to the speed */
    dq_t deviation;   /* what of the back-EMF neither angle nor speed explains */
    frac32_t speed;   /* mechanical */
    uint32_t angle;   /* at the last sensorless_estimate_update_rotation, 2^32 is a turn */
    int32_t rotation;   /* between the last two */
    bool started_reverse;      /* speed was negative when the closed loop began */
    uint16_t standstill_ticks; /* slow ticks in which it hardly turned that way */
    bool deviates;    /* the back-EMF, over some time, fits neither angle nor speed */
    bool mismatch;    /* in the last slow tick it lay off the encoder's q axis */
    bool reliable;    /* angle and speed are reliable */
    bool locked;      /* the PLL follows the back-EMF; otherwise it goes on as it was set */
    bool runs;
} sensorless_estimate_t;

#endif
