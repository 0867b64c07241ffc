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
    FINDING_HARDWARE_BREAK,
    FINDING_OFFSET_FAR,
    FINDING_SEARCH_HELD,
    FINDING_COUNT_CONTRADICTS_INDEX,
    FINDING_HOST_SILENT,
    FINDING_SHAFT_HELD,
    FINDING_RUNS_AWAY,
    FINDING_SINGLE_CHANNEL_TOGGLE,
    FINDING_CURRENT_IN_SHORT,
    FINDING_EMF_WITHOUT_COUNT,
    FINDING_EMF_CONFIRMED,
    FINDING_SEARCH_UNSEEN,
    FINDING_STALL_UNSEEN,
    FINDING_OFF_PATH,
    FINDING_TOO_FAST,
    FINDING_SEARCH_REVERSED,
    FINDING_HOT,
    FINDING_WINDING_HOT,
    FINDING_START_UP_SLOW,
    FINDING_OBSERVER_LOST,
    FINDING_EMF_ELSEWHERE,
    FINDING_OBSERVED_ELSEWHERE,
    FINDING_STALL_ELSEWHERE,
    FINDING_PHASE_SILENT,
    FINDING_CURRENT_NOT_FOLLOWING,
    FINDING_SEARCH_STARVED,
    FINDING_SEARCH_SILENT,
    FINDING_START_UP_SILENT,
    FINDING_CONVERTER_BROKEN,
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
#define SUSPECT_SENSOR UINT16_C(0x01)  /* a current converter looks wrong */
#define SUSPECT_PHASE UINT16_C(0x02)   /* a phase seems to carry no current */
#define SUSPECT_CURRENT UINT16_C(0x04) /* voltage, and hardly a current, of late */
#define SUSPECT_ENCODER UINT16_C(0x08) /* the count has stopped at once, and the windings are shorted because of it */
#define SUSPECT_ANGLE UINT16_C(0x10)   /* the back-EMF is missed by more than its size */

typedef struct {
    finding_set_t confirmed;
    uint16_t suspected; /* SUSPECT_ bits */
    uint16_t silent;    /* phases that seem to carry no current, a bit each .. */
    uint16_t repeating; /* .. and those whose converter repeats its code while others show noise */
    dq_t test_current;  /* asked for on top of the set-point */
} evidence_t;

#endif
