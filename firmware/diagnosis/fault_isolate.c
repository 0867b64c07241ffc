#include "diagnosis/fault_isolate.h"

#include "config/contract_gen.h"

/* ---- the priority table -------------------------------------------------------------------------------------------
 *
 * A row per finding, in the order of priority. It is called `fault`, unless one of the suspicions `instead` explains it:
 * then it is called what `causes` has for that. A name that is not enabled is passed over; `otherwise` is what is left then
 * for a finding that has to stop the axis whatever it is called. firmware/doc/faults.md is generated from these tables.
 */
typedef struct {
    fault_set_t fault;
    uint16_t instead; /* SUSPECT_ bits */
    fault_set_t otherwise;
} rule_t;

#define SENSOR SUSPECT_SENSOR
#define PHASE (SUSPECT_PHASE | SUSPECT_CURRENT)
#define SILENCE SUSPECT_PHASE
#define ENCODER SUSPECT_ENCODER
#define ANGLE SUSPECT_ANGLE

/* clang-format off */
static const rule_t rules[FINDINGS] = {
    [FINDING_OVER_VOLTAGE] = {FAULT_OVER_VOLTAGE, 0, 0}, /* filtered bus voltage above its limit */
    [FINDING_UNDER_VOLTAGE] = {FAULT_UNDER_VOLTAGE, 0, 0}, /* filtered bus voltage below its limit, but for INIT */
    [FINDING_HARDWARE_BREAK] = {FAULT_OVER_CURRENT, SILENCE | ENCODER, 0}, /* the hardware latch has opened the switches; this is sooner than slower checks */
    [FINDING_OFFSET_FAR] = {FAULT_CURRENT_OFFSET, 0, 0}, /* offset of a current amplifier far from mid-scale in CALIB */
    [FINDING_SEARCH_HELD] = {FAULT_ROTOR_SEARCH, 0, 0}, /* rotor search: full current, no movement, or too much time */
    [FINDING_COUNT_CONTRADICTS_INDEX] = {FAULT_ENCODER, 0, 0}, /* a wrap of the count without its index */
    [FINDING_HOST_SILENT] = {FAULT_HOST_SILENT, 0, 0}, /* no command within param.host_timeout */
    [FINDING_SHAFT_HELD] = {FAULT_STALLED, 0, 0}, /* full current, no movement; the test vector found no free rotor */
    [FINDING_RUNS_AWAY] = {FAULT_RUNAWAY, SENSOR | PHASE | ANGLE, 0}, /* speed gained against the full current, or beyond the limit */
    [FINDING_SINGLE_CHANNEL_TOGGLE] = {FAULT_ENCODER_LOST, 0, 0}, /* count goes one back and forth faster than a resting shaft can */
    [FINDING_CURRENT_IN_SHORT] = {FAULT_ENCODER_LOST, 0, 0}, /* READY: the shorted windings carry current, the count stands */
    [FINDING_EMF_WITHOUT_COUNT] = {FAULT_ENCODER_LOST, SENSOR | PHASE, 0}, /* voltage turns like a back-EMF, the count stands */
    [FINDING_EMF_CONFIRMED] = {FAULT_ENCODER_LOST, SENSOR, 0}, /* the same, and a test current flows in full */
    [FINDING_SEARCH_UNSEEN] = {FAULT_ENCODER_LOST, 0, FAULT_ROTOR_SEARCH}, /* rotor search: the flux follows the vector, the count stands */
    [FINDING_STALL_UNSEEN] = {FAULT_ENCODER_LOST, 0, FAULT_STALLED}, /* stall test: the flux follows the vector, the count stands */
    [FINDING_OFF_PATH] = {FAULT_FOLLOWING_ERROR, 0, 0}, /* too far from the shaped set-point (feature FOLLOWING_ERROR) */
    [FINDING_TOO_FAST] = {FAULT_OVER_SPEED, 0, 0}, /* faster than param.over_speed (feature OVER_SPEED) */
    [FINDING_SEARCH_REVERSED] = {FAULT_ENCODER_REVERSED, SENSOR | PHASE, 0}, /* rotor search: the shaft runs away from the vector */
    [FINDING_HOT] = {FAULT_OVER_TEMPERATURE, 0, 0}, /* temperature of the heat sink, with hysteresis */
    [FINDING_START_UP_SLOW] = {FAULT_START_UP, 0, 0}, /* sensorless start-up: no reliable speed in time */
    [FINDING_OBSERVER_LOST] = {FAULT_SPEED_FEEDBACK, SENSOR | PHASE, 0}, /* variance of the observed speed, back-EMF that fits neither angle nor speed, or standstill */
    [FINDING_EMF_ELSEWHERE] = {FAULT_ANGLE_MISMATCH, SENSOR, 0}, /* in motion: voltage that resistance, inductance and back-EMF do not explain */
    [FINDING_OBSERVED_ELSEWHERE] = {FAULT_ANGLE_MISMATCH, 0, 0}, /* observed back-EMF off the encoder's q axis (feature ANGLE_CHECK) */
    [FINDING_STALL_ELSEWHERE] = {FAULT_ANGLE_MISMATCH, 0, FAULT_STALLED}, /* stall test: torque of the turning vector contradicts the angle */
    [FINDING_PHASE_SILENT] = {FAULT_PHASE_LOST, SENSOR, 0}, /* no current in a phase while others carry some */
    [FINDING_CURRENT_NOT_FOLLOWING] = {FAULT_PHASE_LOST, SENSOR, 0}, /* voltage, or a test current asked for, and no current */
    [FINDING_SEARCH_STARVED] = {FAULT_PHASE_LOST, SENSOR, FAULT_ROTOR_SEARCH}, /* rotor search: less than a quarter of the current */
    [FINDING_SEARCH_SILENT] = {FAULT_PHASE_LOST, 0, FAULT_ROTOR_SEARCH}, /* rotor search ended without movement, and no current flows */
    [FINDING_START_UP_SILENT] = {FAULT_PHASE_LOST, 0, FAULT_START_UP}, /* sensorless start-up failed, and no current flows */
    [FINDING_CONVERTER_BROKEN] = {FAULT_CURRENT_SENSE, 0, 0}, /* code off its offset without current, or stuck among noisy ones */
    [FINDING_LOOPS_LATE] = {FAULT_LATE_LOOP, 0, 0}, /* more than two control loops late or left out within 32 ms */
    [FINDING_WATCHDOG_RESET] = {FAULT_WATCHDOG, 0, 0}, /* the watchdog has reset the board */
};

/* What explains other findings, the strongest first. */
static const struct {
    uint16_t suspicion;
    fault_set_t fault;
} causes[] = {
    {SENSOR, FAULT_CURRENT_SENSE}, /* a converter off its offset twice, or six equal codes among noisy ones */
    {PHASE, FAULT_PHASE_LOST}, /* a phase silent for two ticks or in three directions, or eight ticks of voltage without current */
    {ENCODER, FAULT_ENCODER_LOST}, /* the count had stopped at once, and READY has shorted the windings */
    {ANGLE, FAULT_ANGLE_MISMATCH}, /* the back-EMF is missed by more than its size */
};

/* Faults that are concluded from currents: void when the current feedback turns out to be false. */
#define CURRENT_DERIVED_FAULTS                                                                                         \
    (FAULT_CURRENT_OFFSET | FAULT_ROTOR_SEARCH | FAULT_ENCODER_LOST | FAULT_ENCODER_REVERSED | FAULT_ANGLE_MISMATCH |  \
     FAULT_PHASE_LOST | FAULT_SPEED_FEEDBACK | FAULT_START_UP)

/* Causes that are found after their consequence. `within` [PWM periods]: a converter that repeats its code is found within
 * 128 ms; the loops are counted once in a slow tick, the over-current that they have let happen is seen at once. */
static const struct {
    fault_set_t fault;
    uint32_t within;
    fault_set_t after;
    fault_set_t voids;
} revisions[] = {
    {FAULT_CURRENT_SENSE, 2048, CURRENT_DERIVED_FAULTS | FAULT_OVER_CURRENT, CURRENT_DERIVED_FAULTS}, /* current feedback invalid; faults derived from it are void */
    {FAULT_LATE_LOOP, 16, FAULT_OVER_CURRENT, 0}, /* duties stood still while the shaft went on */
};
/* clang-format on */

#define COUNT(table) (sizeof(table) / sizeof(table)[0])

/* A silent phase whose converter repeats its code is no evidence of a lost phase, nor is any while a converter is off. */
static uint16_t suspicions(const evidence_t *evidence)
{
    const bool sound = (evidence->suspected & SENSOR) == 0U;
    const bool silent = (evidence->silent & ~(uint32_t)evidence->repeating) != 0U;
    return (uint16_t)(evidence->suspected | ((sound && silent) ? SUSPECT_PHASE : 0U));
}

static fault_set_t cause_of(uint16_t suspected, fault_set_t enabled)
{
    for (uint16_t i = 0; suspected != 0U && i < COUNT(causes); i++) {
        if ((suspected & causes[i].suspicion) != 0U && (enabled & causes[i].fault) != 0U) {
            return causes[i].fault;
        }
    }
    return 0;
}

/* The name of one finding; 0 if none is enabled. */
static fault_set_t name_of(const rule_t *rule, uint16_t suspected, fault_set_t enabled)
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
        const rule_t *rule = &rules[fault_lowest(findings)];
        if (((rule->fault | rule->otherwise) & enabled) != 0U || cause_of(rule->instead, enabled) != 0U) {
            return true;
        }
    }
    return false;
}

fault_verdict_t fault_isolate(const evidence_t *evidence, fault_set_t enabled)
{
    const uint16_t suspected = suspicions(evidence);
    fault_verdict_t verdict = {0, 0};
    for (finding_set_t findings = evidence->confirmed; findings != 0U; findings &= findings - 1U) {
        const rule_t *rule = &rules[fault_lowest(findings)];
        const fault_set_t name = name_of(rule, suspected, enabled);
        verdict.first = (verdict.first == 0U) ? name : verdict.first;
        verdict.faults |= name | (rule->fault & FAULT_OVER_CURRENT & enabled); /* that there was */
    }
    return verdict;
}

fault_set_t fault_names(finding_set_t findings)
{
    fault_set_t faults = 0;
    for (; findings != 0U; findings &= findings - 1U) {
        faults |= rules[fault_lowest(findings)].fault;
    }
    return faults;
}

finding_set_t fault_wanted(finding_set_t findings, fault_set_t enabled)
{
    finding_set_t wanted = 0;
    for (; findings != 0U; findings &= findings - 1U) {
        const uint16_t lowest = fault_lowest(findings);
        wanted |= ((rules[lowest].fault & enabled) != 0U) ? UINT32_C(1) << lowest : 0U;
    }
    return wanted;
}

fault_revision_t fault_revise(fault_set_t fresh, fault_set_t captured, uint32_t age)
{
    for (uint16_t i = 0; i < COUNT(revisions); i++) {
        if ((fresh & revisions[i].fault) != 0U && age < revisions[i].within && (captured & revisions[i].after) != 0U) {
            return (fault_revision_t){revisions[i].fault, revisions[i].voids};
        }
    }
    return (fault_revision_t){0, 0};
}
