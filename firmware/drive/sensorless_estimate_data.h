/* sensorless_estimate_data.h - state of the back-EMF observer and the PLL of an axis (sensorless_estimate.h). */
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
    ab_t emf; /* back-EMF in the stator frame, last slow tick, Q1.15 of full-scale voltage */
    frac16_t size; /* amplitude of the back-EMF, Q1.15 of full-scale voltage */
    frac16_t expected_emf; /* expected back-EMF at `speed`, Q1.15 of full-scale voltage */
    dq_t deviation; /* observed minus expected back-EMF in the PLL frame, Q1.15 of full-scale voltage */
    frac32_t speed; /* mechanical, Q1.31 of full-scale speed */
    uint32_t angle; /* electrical angle at the last sensorless_estimate_update_rotation, 2^32 is one turn */
    int32_t rotation; /* change of `angle` in the last slow tick, 2^32 is one turn */
    bool started_reverse; /* the speed was negative at the start of the closed loop */
    uint16_t standstill_ticks; /* consecutive slow ticks below half of the minimum speed, or reversed */
    bool deviates; /* the filtered deviation exceeds its tolerances */
    bool mismatch; /* check of an encoder: the back-EMF of the last slow tick contradicts the encoder angle */
    bool reliable; /* angle and speed are reliable */
    bool locked; /* the PLL follows the back-EMF; otherwise its angle is set */
    bool runs; /* the observer is running */
} sensorless_estimate_t;

#endif
