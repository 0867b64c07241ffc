/* fault_latch.h - capture, record and clear the faults of an axis (fault codes: servo_msgs_py/variables.toml).
 *
 * pending    the cause is present now
 * captured   the cause was present since the last clearing; stops the axis
 * enabled    faults that can be captured; FAULTS_ALWAYS cannot be disabled
 */
#ifndef SERVO_DIAGNOSIS_FAULT_LATCH_H
#define SERVO_DIAGNOSIS_FAULT_LATCH_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

#define FAULT_SAMPLES 64 /* a power of two */

/* Record of the first fault: ring buffer of FAULT_SAMPLES samples, one per slow tick (32 ms), frozen at the first
 * fault. The last sample is taken in the PWM period of the fault, so it also shows an over-current. */
typedef struct {
    fault_set_t pending; /* present faults (axisN.pending), not frozen */
    uint32_t tick; /* PWM periods since reset at the first fault */
    uint16_t code; /* code of the first fault */
    uint16_t state; /* state_t before the fault */
    uint16_t substate; /* substate_t before the fault */
    uint16_t next; /* index of the oldest sample, which is overwritten next */
    uint16_t size; /* valid samples, at most FAULT_SAMPLES */
    uint16_t unused; /* padding: equal size on all processors */
    frac16_t i_d[FAULT_SAMPLES]; /* Q1.15 of full-scale current */
    frac16_t i_q[FAULT_SAMPLES]; /* Q1.15 of full-scale current */
    frac16_t theta_e[FAULT_SAMPLES]; /* Q1.15 of pi, electrical; for the phase currents */
    frac16_t u_dc[FAULT_SAMPLES]; /* Q1.15 of the full-scale bus voltage */
    frac16_t speed[FAULT_SAMPLES]; /* Q1.15 of full-scale speed */
} fault_record_t;

typedef struct {
    finding_set_t findings; /* findings of the captured faults */
    fault_set_t captured;
    fault_set_t pending;
    fault_set_t enabled;
    uint16_t first; /* code of the first fault; 0: none */
    fault_record_t *record; /* record of the first fault, memory of the owner */
    const uint32_t *clock; /* PWM periods since reset, memory of the owner */
} fault_latch_t;

/* Fault code of the lowest fault of a set: bit number plus one; 0: no fault. */
uint16_t fault_code(fault_set_t faults);

/* `record` and `clock` must stay valid as long as the latch. */
void fault_latch_init(fault_latch_t *latch, fault_record_t *record, const uint32_t *clock);

/* Store one sample, until the first fault. */
void fault_latch_sample(fault_latch_t *latch, const observation_t *observation);

/* Isolate and capture the faults of the evidence. Returns the faults that stop the axis. */
fault_set_t fault_latch_capture(fault_latch_t *latch, const evidence_t *evidence, const observation_t *observation);

/* Clear all faults except those in `remain`. */
void fault_latch_clear(fault_latch_t *latch, fault_set_t remain);

#endif
