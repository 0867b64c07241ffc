/* fault_latch.h - the faults of an axis: captured, recorded, cleared (fault codes: servo_msgs_py/variables.toml).
 *
 * pending    the cause is there now
 * captured   it has been there since the last clearing: these stop the axis
 * enabled    what may be captured; FAULTS_ALWAYS cannot be switched off
 */
#ifndef SERVO_DIAGNOSIS_FAULT_LATCH_H
#define SERVO_DIAGNOSIS_FAULT_LATCH_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

#define FAULT_SAMPLES 64 /* a power of two */

/* What led to the first fault: a ring that stands still from then on. One sample per watch, 32 ms in all: faults of
 * motion take that long, and in the frame of the rotor nothing is faster than the current loop but an over-current, which
 * the last sample, taken in the period of the fault, shows. */
typedef struct {
    fault_set_t pending;
    uint32_t tick; /* PWM periods since reset at the first fault */
    uint16_t code; /* of the first fault */
    uint16_t state; /* state_t and substate_t that it ended */
    uint16_t substate; /* substate_t that it ended */
    uint16_t next; /* oldest sample, the next to be overwritten */
    uint16_t size; /* samples that have been taken, FAULT_SAMPLES at most */
    uint16_t unused; /* the size is the same on every machine */
    frac16_t i_d[FAULT_SAMPLES]; /* Q1.15 of full-scale current */
    frac16_t i_q[FAULT_SAMPLES]; /* the same */
    frac16_t theta_e[FAULT_SAMPLES]; /* turns both back into phase currents */
    frac16_t u_dc[FAULT_SAMPLES]; /* Q1.15 of the full-scale bus voltage */
    frac16_t speed[FAULT_SAMPLES]; /* Q1.15 of full-scale speed */
} fault_record_t;

typedef struct {
    finding_set_t findings; /* that have been captured under whatever name */
    fault_set_t captured;
    fault_set_t pending;
    fault_set_t enabled;
    uint16_t first;         /* code of the fault that came first, 0 without one */
    fault_record_t *record; /* of the first fault; the owner's */
    const uint32_t *clock;  /* PWM periods since reset; the owner's */
} fault_latch_t;

/* Code of the lowest fault of a set: its bit plus one; 0 for no fault. */
uint16_t fault_code(fault_set_t faults);

/* `record` and `clock` belong to the caller and live as long as the latch. */
void fault_latch_init(fault_latch_t *latch, fault_record_t *record, const uint32_t *clock);

/* One sample of what is observed now, until there is a fault. */
void fault_latch_sample(fault_latch_t *latch, const observation_t *observation);

/* Name and capture what has been found. Returns the faults that are to stop the axis. */
fault_set_t fault_latch_capture(fault_latch_t *latch, const evidence_t *evidence, const observation_t *observation);

/* Clear all faults but those that `remain`. */
void fault_latch_clear(fault_latch_t *latch, fault_set_t remain);

#endif
