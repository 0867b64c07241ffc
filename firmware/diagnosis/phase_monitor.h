/* phase_monitor.h - phases of the motor that carry no current.
 *
 * A lost phase is silent while the others are not: at rest although current is asked of it, turning often and in every
 * direction of the rotor. Where no phase carries current, the voltage that should drive one tells.
 */
#ifndef SERVO_DIAGNOSIS_PHASE_MONITOR_H
#define SERVO_DIAGNOSIS_PHASE_MONITOR_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

typedef struct {
    uint16_t no_current_ticks[OBSERVED_PHASES];  /* slow ticks without the current that is asked for */
    uint16_t octants[OBSERVED_PHASES]; /* eighths of an electrical turn in which it was silent, a bit each; how often */
    frac16_t last_i_q_ref; /* i_q* of the last slow tick */
    uint16_t low_current_ticks; /* recent slow ticks with too little current for that */
    bool lost; /* one of them is */
    uint16_t age; /* slow ticks */
    uint16_t no_response_ticks; /* slow ticks in a row in which the current did not follow the voltage .. */
    uint16_t no_response_count; /* .. and of late, in a row or not */
} phase_monitor_t;

/* One slow tick; sets `observation->conducting_phases`. While no current is controlled what is known is forgotten. */
void phase_monitor_step(phase_monitor_t *monitor, const winding_config_t *config, observation_t *observation,
                        evidence_t *evidence);

void phase_monitor_suspect(const phase_monitor_t *monitor, evidence_t *evidence);

#endif
