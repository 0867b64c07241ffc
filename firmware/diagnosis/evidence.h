/* evidence.h - output of the monitors: confirmed findings, suspicions, and a test current.
 *
 * Monitors exchange only the last three members of observation_t. The priority table (fault_isolate.h) decides which
 * fault is reported for a finding, and which suspicion of another monitor explains it.
 */
#ifndef SERVO_DIAGNOSIS_EVIDENCE_H
#define SERVO_DIAGNOSIS_EVIDENCE_H

#include "control/transforms.h"
#include "diagnosis/findings_gen.h"

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
