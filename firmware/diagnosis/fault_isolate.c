#include "diagnosis/fault_isolate.h"

#include "config/contract_gen.h"
#include "diagnosis/fault_rules.h"

static fault_rule_t rule_of(uint16_t finding)
{
    fault_rule_t rule;
    program_table_copy(&rule, &fault_rules[finding], sizeof rule);
    return rule;
}

/* A phase without current whose ADC code is constant is no evidence of a lost phase; neither is any phase without current
 * while a current measurement is suspected. */
static uint16_t suspected_causes(const evidence_t *evidence)
{
    const bool sound = (evidence->suspected & SUSPECT_CURRENT_SENSE) == 0U;
    const bool no_current = (evidence->phases_without_current & ~(uint32_t)evidence->repeating) != 0U;
    return (uint16_t)(evidence->suspected | ((sound && no_current) ? SUSPECT_PHASE : 0U));
}

static fault_set_t cause_of(uint16_t suspected, fault_set_t enabled)
{
    for (uint16_t i = 0; suspected != 0U && i < FAULT_CAUSES; i++) {
        fault_cause_t cause;
        program_table_copy(&cause, &fault_causes[i], sizeof cause);
        if ((suspected & cause.suspicion) != 0U && (enabled & cause.fault) != 0U) {
            return cause.fault;
        }
    }
    return 0;
}

/* Fault reported for one finding; 0 if none of the candidates is enabled. */
static fault_set_t name_of(const fault_rule_t *rule, uint16_t suspected, fault_set_t enabled)
{
    const fault_set_t cause = cause_of(suspected & rule->instead, enabled);
    if (cause != 0U) {
        return cause;
    }
    return ((rule->fault & enabled) != 0U) ? rule->fault : rule->otherwise & enabled;
}

bool fault_relevant(finding_set_t findings, fault_set_t enabled)
{
    for (; findings != 0U; findings &= findings - 1U) {
        const fault_rule_t rule = rule_of(fault_lowest(findings));
        if (((rule.fault | rule.otherwise) & enabled) != 0U || cause_of(rule.instead, enabled) != 0U) {
            return true;
        }
    }
    return false;
}

fault_verdict_t fault_isolate(const evidence_t *evidence, fault_set_t enabled)
{
    const uint16_t suspected = suspected_causes(evidence);
    fault_verdict_t verdict = {0, 0};
    for (finding_set_t findings = evidence->confirmed; findings != 0U; findings &= findings - 1U) {
        const fault_rule_t rule = rule_of(fault_lowest(findings));
        const fault_set_t name = name_of(&rule, suspected, enabled);
        verdict.first = (verdict.first == 0U) ? name : verdict.first;
        verdict.faults |= name | (rule.fault & FAULT_OVER_CURRENT & enabled); /* over-current is always added */
    }
    return verdict;
}

fault_set_t fault_names(finding_set_t findings)
{
    fault_set_t faults = 0;
    for (; findings != 0U; findings &= findings - 1U) {
        faults |= rule_of(fault_lowest(findings)).fault;
    }
    return faults;
}

finding_set_t fault_enabled(finding_set_t findings, fault_set_t enabled)
{
    finding_set_t result = 0;
    for (; findings != 0U; findings &= findings - 1U) {
        const uint16_t lowest = fault_lowest(findings);
        result |= ((rule_of(lowest).fault & enabled) != 0U) ? FOUND(lowest) : 0U;
    }
    return result;
}

fault_revision_t fault_revise(fault_set_t fresh, fault_set_t captured, uint32_t age)
{
    for (uint16_t i = 0; i < FAULT_REVISIONS; i++) {
        fault_revision_rule_t rule;
        program_table_copy(&rule, &fault_revisions[i], sizeof rule);
        if ((fresh & rule.fault) != 0U && age < rule.within && (captured & rule.after) != 0U) {
            return (fault_revision_t){rule.fault, rule.voids};
        }
    }
    return (fault_revision_t){0, 0};
}
