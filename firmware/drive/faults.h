/* faults.h - sets of faults, and the record of the first one (fault codes: servo_msgs_py/variables.toml).
 *
 * pending    the cause is there now
 * captured   it has been there since the last clearing: these stop the axis
 * enabled    what may be captured; FAULTS_ALWAYS cannot be switched off
 */
#ifndef SERVO_DRIVE_FAULTS_H
#define SERVO_DRIVE_FAULTS_H

#include "math/frac.h"

typedef uint32_t fault_set_t;

#define FAULT_SAMPLES 64 /* a power of two */

/* What led to the first fault: a ring that stands still from then on. One sample per watch, 32 ms in all: faults of
 * motion take that long, and in the frame of the rotor nothing is faster than the current loop but an over-current, which
 * the last sample, taken in the period of the fault, shows. */
typedef struct {
    fault_set_t pending;
    uint32_t tick; /* PWM periods since reset at the first fault */
    uint16_t code; /* of the first fault */
    uint16_t state; /* state_t and substate_t that it ended */
    uint16_t substate;
    uint16_t next; /* oldest sample, the next to be overwritten */
    uint16_t size; /* samples that have been taken, FAULT_SAMPLES at most */
    uint16_t unused; /* the size is the same on every machine */
    frac16_t i_d[FAULT_SAMPLES];
    frac16_t i_q[FAULT_SAMPLES];
    frac16_t theta_e[FAULT_SAMPLES]; /* turns both back into phase currents */
    frac16_t u_dc[FAULT_SAMPLES];
    frac16_t speed[FAULT_SAMPLES];
} fault_record_t;

struct axis;

/* Code of the lowest fault of a set: its bit plus one; 0 for no fault. */
uint16_t fault_code(fault_set_t faults);

/* One sample of what the axis does now. */
void fault_record_sample(fault_record_t *record, const struct axis *axis);

/* The first of `faults` is the first fault of the axis. */
void fault_record_first(fault_record_t *record, const struct axis *axis, fault_set_t faults);

#endif
