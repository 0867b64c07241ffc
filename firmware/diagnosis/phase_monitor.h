/* phase_monitor.h - phases of the motor that carry no current.
 *
 * A phase is lost if its current stays below a minimum while the others conduct: at rest with a non-zero set-point of
 * that phase, in rotation in at least 6 of 8 octants. If no phase conducts, the voltage set-point is evaluated instead.
 */
#ifndef SERVO_DIAGNOSIS_PHASE_MONITOR_H
#define SERVO_DIAGNOSIS_PHASE_MONITOR_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

typedef struct {
    uint16_t no_current_ticks[OBSERVED_PHASES];  /* slow ticks without current at a non-zero set-point */
    uint16_t octants[OBSERVED_PHASES]; /* bits 0..7: octants of the rotor without current; above: slow ticks */
    frac16_t last_i_q_ref; /* i_q* of the last slow tick, Q1.15 of full-scale current */
    uint16_t low_current_ticks; /* slow ticks since the last decay with too little current for the octant test */
    bool lost; /* a phase is confirmed as lost */
    uint16_t age; /* slow ticks, for the decay of the counters */
    uint16_t no_response_ticks; /* consecutive slow ticks in which the current did not follow the voltage */
    uint16_t no_response_count; /* slow ticks in which the current did not follow the voltage, with slow decay */
} phase_monitor_t;

/* One slow tick; sets `observation->conducting_phases`. Resets while no current is controlled. */
void phase_monitor_step(phase_monitor_t *monitor, const winding_config_t *config, observation_t *observation,
                        evidence_t *evidence);

/* Add suspicions about phases and about missing current. */
void phase_monitor_suspect(const phase_monitor_t *monitor, evidence_t *evidence);

#endif
