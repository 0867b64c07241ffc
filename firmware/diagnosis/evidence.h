/* evidence.h - output of the monitors: confirmed findings, suspicions, and a test current.
 *
 * Monitors exchange only the last three members of observation_t. The priority table (fault_isolate.h) decides which
 * fault is reported for a finding, and which suspicion of another monitor explains it.
 */
#ifndef SERVO_DIAGNOSIS_EVIDENCE_H
#define SERVO_DIAGNOSIS_EVIDENCE_H

#include "control/transforms.h"

/* FAULT_ bits (config/contract_gen.h). */
typedef uint32_t fault_set_t;

/* Number of the lowest bit of a non-empty set. */
static inline uint16_t fault_lowest(uint64_t set)
{
    uint16_t number = 0;
    for (uint16_t width = 32; width != 0U; width >>= 1) {
        if ((set & ((UINT64_C(1) << width) - 1U)) == 0U) {
            set >>= width;
            number = (uint16_t)(number + width);
        }
    }
    return number;
}

/* In order of priority: among findings that are raised together, the first one determines the first fault. */
typedef enum {
    FINDING_OVER_VOLTAGE,
    FINDING_UNDER_VOLTAGE,
    FINDING_OVER_CURRENT_TRIP,
    FINDING_OFFSET_OUT_OF_RANGE,
    FINDING_SEARCH_NO_MOVEMENT,
    FINDING_COUNT_CONTRADICTS_INDEX,
    FINDING_HOST_SILENT,
    FINDING_SHAFT_BLOCKED,
    FINDING_RUNAWAY,
    FINDING_SINGLE_CHANNEL_TOGGLE,
    FINDING_SHORT_CURRENT_WITHOUT_COUNT,
    FINDING_EMF_WITHOUT_COUNT,
    FINDING_EMF_CONFIRMED,
    FINDING_SEARCH_WITHOUT_COUNT,
    FINDING_STALL_WITHOUT_COUNT,
    FINDING_FOLLOWING_ERROR,
    FINDING_OVER_SPEED,
    FINDING_SEARCH_REVERSED,
    FINDING_HEAT_SINK_HOT,
    FINDING_WINDING_HOT,
    FINDING_START_UP_SLOW,
    FINDING_OBSERVER_LOST,
    FINDING_EMF_ANGLE_MISMATCH,
    FINDING_OBSERVER_ANGLE_MISMATCH,
    FINDING_STALL_ANGLE_MISMATCH,
    FINDING_PHASE_NO_CURRENT,
    FINDING_CURRENT_NOT_FOLLOWING,
    FINDING_SEARCH_LOW_CURRENT,
    FINDING_SEARCH_END_NO_CURRENT,
    FINDING_START_UP_NO_CURRENT,
    FINDING_CURRENT_SENSE_FAILED,
    FINDING_LOOPS_LATE,
    FINDING_WATCHDOG_RESET,
    FINDING_HOMING_FAILED,
    FINDING_ENABLE_OPEN,
    FINDING_LIMIT_SWITCH,
    FINDINGS,
} finding_t;

/* Set of findings, one bit each. */
typedef uint64_t finding_set_t;
#define FOUND(finding) (UINT64_C(1) << (finding))

/* Suspicions: possible causes of a finding. */
#define SUSPECT_CURRENT_SENSE UINT16_C(0x01)  /* implausible ADC codes of a current measurement */
#define SUSPECT_PHASE UINT16_C(0x02)   /* probably no current in a phase */
#define SUSPECT_CURRENT UINT16_C(0x04) /* recently voltage without current */
#define SUSPECT_ENCODER UINT16_C(0x08) /* count stopped abruptly and the windings are shorted (READY) */
#define SUSPECT_ANGLE UINT16_C(0x10)   /* unexplained voltage exceeds the expected back-EMF */

typedef struct {
    finding_set_t confirmed;
    uint16_t suspected; /* SUSPECT_ bits */
    uint16_t phases_without_current;    /* phases that probably carry no current, one bit each */
    uint16_t repeating; /* phases whose ADC code is constant while others show noise, one bit each */
    dq_t test_current;  /* requested in addition to the set-point, Q1.15 of full-scale current */
} evidence_t;

#endif
