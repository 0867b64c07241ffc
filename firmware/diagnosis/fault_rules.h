/* fault_rules.h - the tables that name faults; fault_isolate.c applies them. Tables only, so that a chip may keep them in a
 * slower memory; not in the data flash, which cannot be read while it is written. */
#ifndef SERVO_DIAGNOSIS_FAULT_RULES_H
#define SERVO_DIAGNOSIS_FAULT_RULES_H

#include "diagnosis/evidence.h"
#include "math/program_table.h"

#define FAULT_CAUSES 4
#define FAULT_REVISIONS 2

typedef struct {
    fault_set_t fault;
    uint16_t instead; /* SUSPECT_ bits */
    fault_set_t otherwise;
} fault_rule_t;

typedef struct {
    uint16_t suspicion; /* SUSPECT_ bit */
    fault_set_t fault;
} fault_cause_t;

typedef struct {
    fault_set_t fault;
    uint32_t within; /* PWM periods */
    fault_set_t after;
    fault_set_t voids;
} fault_revision_rule_t;

extern PROGRAM_TABLE fault_rule_t fault_rules[FINDINGS];
extern PROGRAM_TABLE fault_cause_t fault_causes[FAULT_CAUSES];
extern PROGRAM_TABLE fault_revision_rule_t fault_revisions[FAULT_REVISIONS];

#endif
