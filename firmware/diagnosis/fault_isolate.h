/* fault_isolate.h - fault isolation: determines the faults of a set of findings and suspicions; causes replace their
 * consequences. */
#ifndef SERVO_DIAGNOSIS_FAULT_ISOLATE_H
#define SERVO_DIAGNOSIS_FAULT_ISOLATE_H

#include "diagnosis/evidence.h"

typedef struct {
    fault_set_t first;  /* fault of the highest priority; 0: none is enabled */
    fault_set_t faults; /* faults of all findings */
} fault_verdict_t;

/* True if at least one finding can be reported as an enabled fault; otherwise suspicions are not needed. */
bool fault_relevant(finding_set_t findings, fault_set_t enabled);

/* Apply the priority table. */
fault_verdict_t fault_isolate(const evidence_t *evidence, fault_set_t enabled);

/* Faults of the findings without regard to suspicions. */
fault_set_t fault_names(finding_set_t findings);

/* Findings whose own fault is enabled. */
finding_set_t fault_enabled(finding_set_t findings, fault_set_t enabled);

typedef struct {
    fault_set_t first; /* replaces the first fault; 0: no change */
    fault_set_t voids; /* captured faults to be removed, because their input was invalid */
} fault_revision_t;

/* Check whether one of the `fresh` faults, `age` PWM periods after the first fault, is the cause of the `captured`
 * ones. */
fault_revision_t fault_revise(fault_set_t fresh, fault_set_t captured, uint32_t age);

#endif
