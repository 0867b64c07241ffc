/* fault_rules.h - the types of the tables in fault_rules_gen.c; applied by fault_isolate.c. In program memory
 * (PROGRAM_TABLE), because the data flash cannot be read while it is written. */
#ifndef SERVO_DIAGNOSIS_FAULT_RULES_H
#define SERVO_DIAGNOSIS_FAULT_RULES_H

#include "diagnosis/evidence.h"
#include "math/program_table.h"

typedef struct {
    fault_set_t fault; /* fault reported for a finding */
    uint16_t instead; /* SUSPECT_ bits of causes that are reported instead */
    fault_set_t otherwise; /* reported if `fault` is not enabled; 0: none */
} fault_rule_t;

typedef struct {
    uint16_t suspicion; /* SUSPECT_ bit */
    fault_set_t fault; /* fault of the suspected cause */
} fault_cause_t;

typedef struct {
    fault_set_t fault; /* cause that is detected after its consequence */
    uint32_t within; /* largest delay after the first fault, PWM periods */
    fault_set_t after; /* consequences that are replaced */
    fault_set_t voids; /* consequences that are removed */
} fault_revision_rule_t;

extern PROGRAM_TABLE fault_rule_t fault_rules[FINDINGS];
extern PROGRAM_TABLE fault_cause_t fault_causes[FAULT_CAUSES];
extern PROGRAM_TABLE fault_revision_rule_t fault_revisions[FAULT_REVISIONS];

#endif
