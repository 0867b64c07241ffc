/* fault_isolate.h - from evidence to the name of the fault: cause before consequence. */
#ifndef SERVO_DIAGNOSIS_FAULT_ISOLATE_H
#define SERVO_DIAGNOSIS_FAULT_ISOLATE_H

#include "diagnosis/evidence.h"

typedef struct {
    fault_set_t first;  /* the one that names them all; 0 if there is none that is enabled */
    fault_set_t faults; /* all of them */
} fault_verdict_t;

/* May findings have a name that is enabled? If not, nothing has to be suspected for them. */
bool fault_relevant(finding_set_t findings, fault_set_t enabled);

fault_verdict_t fault_isolate(const evidence_t *evidence, fault_set_t enabled);

/* Faults that findings are called where nothing explains them better. */
fault_set_t fault_names(finding_set_t findings);

/* Those findings that may stop an axis under their own name. */
finding_set_t fault_wanted(finding_set_t findings, fault_set_t enabled);

typedef struct {
    fault_set_t first; /* the name that the first fault gets instead; 0: it stays */
    fault_set_t voids; /* captured faults that were concluded from what is false */
} fault_revision_t;

/* `fresh` faults, `age` PWM periods after the first one: is one of them the cause of those that were `captured`? */
fault_revision_t fault_revise(fault_set_t fresh, fault_set_t captured, uint32_t age);

#endif
