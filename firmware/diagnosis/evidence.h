/* evidence.h - what the monitors say: findings that are confirmed, suspicions, and a current that a test needs.
 *
 * A monitor knows nothing of the others. What a finding is called, and which suspicion of another monitor explains it
 * better, is decided by the priority table (fault_isolate.h).
 */
#ifndef SERVO_DIAGNOSIS_EVIDENCE_H
#define SERVO_DIAGNOSIS_EVIDENCE_H

#include "control/transforms.h"

/* FAULT_ bits (config/contract_gen.h). */
typedef uint32_t fault_set_t;

/* Number of the lowest bit of a set that is not empty. */
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

/* In the order of their priority: of findings of the same period the first one names the first fault. */
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
    FINDING_SEARCH_NO_CURRENT,
    FINDING_START_UP_NO_CURRENT,
    FINDING_CURRENT_SENSE_FAILED,
    FINDING_LOOPS_LATE,
    FINDING_WATCHDOG_RESET,
    FINDING_HOMING_FAILED,
    FINDING_ENABLE_OPEN,
    FINDING_LIMIT_SWITCH,
    FINDINGS,
} finding_t;

/* A bit per finding. */
typedef uint64_t finding_set_t;
#define FOUND(finding) (UINT64_C(1) << (finding))

/* What may be the cause of something else. */
#define SUSPECT_CURRENT_SENSE UINT16_C(0x01)  /* a current converter looks wrong */
#define SUSPECT_PHASE UINT16_C(0x02)   /* a phase seems to carry no current */
#define SUSPECT_CURRENT UINT16_C(0x04) /* voltage, and hardly a current, of late */
#define SUSPECT_ENCODER UINT16_C(0x08) /* the count has stopped at once, and the windings are shorted because of it */
#define SUSPECT_ANGLE UINT16_C(0x10)   /* the back-EMF is missed by more than its size */

typedef struct {
    finding_set_t confirmed;
    uint16_t suspected; /* SUSPECT_ bits */
    uint16_t phases_without_current;    /* phases that seem to carry no current, a bit each .. */
    uint16_t repeating; /* .. and those whose converter repeats its code while others show noise */
    dq_t test_current;  /* asked for on top of the set-point */
} evidence_t;

#endif
