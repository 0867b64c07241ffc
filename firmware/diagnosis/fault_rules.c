#include "diagnosis/fault_rules.h"

#include "config/contract_gen.h"

/* ---- the priority table -------------------------------------------------------------------------------------------
 *
 * One row per finding, in the order of priority. A finding is reported as `fault`, unless one of the suspicions in
 * `instead` explains it: then it is reported as the entry of that suspicion in `fault_causes`. A fault that is not
 * enabled is skipped; `otherwise` is reported then for a finding that must stop the axis in any case.
 * firmware/doc/faults.md is generated from these tables.
 */
#define CURRENT_SENSE SUSPECT_CURRENT_SENSE
#define PHASE (SUSPECT_PHASE | SUSPECT_CURRENT)
#define NO_PHASE_CURRENT SUSPECT_PHASE
#define ENCODER SUSPECT_ENCODER
#define ANGLE SUSPECT_ANGLE

/* clang-format off */
PROGRAM_TABLE fault_rule_t fault_rules[FINDINGS] = {
    [FINDING_OVER_VOLTAGE] = {FAULT_OVER_VOLTAGE, 0, 0}, /* filtered bus voltage above its limit */
    [FINDING_UNDER_VOLTAGE] = {FAULT_UNDER_VOLTAGE, 0, 0}, /* filtered bus voltage below its limit, except in INIT */
    [FINDING_OVER_CURRENT_TRIP] = {FAULT_OVER_CURRENT, NO_PHASE_CURRENT | ENCODER, 0}, /* hardware over-current latch has switched the outputs off; faster than the other checks */
    [FINDING_OFFSET_OUT_OF_RANGE] = {FAULT_CURRENT_OFFSET, 0, 0}, /* CALIB: offset of a current amplifier far from mid-scale */
    [FINDING_SEARCH_NO_MOVEMENT] = {FAULT_ROTOR_SEARCH, 0, 0}, /* rotor search: no movement at full current, or timeout */
    [FINDING_COUNT_CONTRADICTS_INDEX] = {FAULT_ENCODER, 0, 0}, /* encoder count wrapped without an index pulse */
    [FINDING_HOST_SILENT] = {FAULT_HOST_SILENT, 0, 0}, /* no command within param.host_timeout, or, with the feature STARVED, no trajectory point in time */
    [FINDING_SHAFT_BLOCKED] = {FAULT_STALLED, 0, 0}, /* no movement at full current; the test vector found no free rotor */
    [FINDING_RUNAWAY] = {FAULT_RUNAWAY, CURRENT_SENSE | PHASE | ANGLE, 0}, /* speed rises against full current, or rises further beyond the limit */
    [FINDING_SINGLE_CHANNEL_TOGGLE] = {FAULT_ENCODER_LOST, 0, 0}, /* count alternates by one, faster than a shaft at rest can dither */
    [FINDING_SHORT_CURRENT_WITHOUT_COUNT] = {FAULT_ENCODER_LOST, 0, 0}, /* READY: current in the shorted windings, encoder count constant */
    [FINDING_EMF_WITHOUT_COUNT] = {FAULT_ENCODER_LOST, CURRENT_SENSE | PHASE, 0}, /* voltage rotates like a back-EMF, encoder count constant */
    [FINDING_EMF_CONFIRMED] = {FAULT_ENCODER_LOST, CURRENT_SENSE, 0}, /* voltage rotates like a back-EMF, the full test current flows, encoder count constant */
    [FINDING_SEARCH_WITHOUT_COUNT] = {FAULT_ENCODER_LOST, 0, FAULT_ROTOR_SEARCH}, /* rotor search: flux follows the vector, encoder count constant */
    [FINDING_STALL_WITHOUT_COUNT] = {FAULT_ENCODER_LOST, 0, FAULT_STALLED}, /* stall test: flux follows the vector, encoder count constant */
    [FINDING_FOLLOWING_ERROR] = {FAULT_FOLLOWING_ERROR, 0, 0}, /* position too far from the shaped set-point (feature FOLLOWING_ERROR) */
    [FINDING_OVER_SPEED] = {FAULT_OVER_SPEED, 0, 0}, /* speed above param.over_speed (feature OVER_SPEED) */
    [FINDING_SEARCH_REVERSED] = {FAULT_ENCODER_REVERSED, CURRENT_SENSE | PHASE, 0}, /* rotor search: the count follows the vector in the opposite direction */
    [FINDING_HEAT_SINK_HOT] = {FAULT_OVER_TEMPERATURE, 0, 0}, /* heat sink temperature above its limit, with hysteresis */
    [FINDING_WINDING_HOT] = {FAULT_MOTOR_TEMPERATURE, 0, 0}, /* estimated winding temperature above its limit, with hysteresis (feature WINDING_MODEL) */
    [FINDING_START_UP_SLOW] = {FAULT_START_UP, 0, 0}, /* sensorless start-up: no reliable speed estimate in time */
    [FINDING_OBSERVER_LOST] = {FAULT_SPEED_FEEDBACK, CURRENT_SENSE | PHASE, 0}, /* observed speed too noisy, back-EMF inconsistent with angle or speed, or standstill */
    [FINDING_EMF_ANGLE_MISMATCH] = {FAULT_ANGLE_MISMATCH, CURRENT_SENSE, 0}, /* in motion: voltage not explained by resistance, inductance and back-EMF */
    [FINDING_OBSERVER_ANGLE_MISMATCH] = {FAULT_ANGLE_MISMATCH, 0, 0}, /* observed back-EMF not on the q axis of the encoder angle (feature ANGLE_CHECK) */
    [FINDING_STALL_ANGLE_MISMATCH] = {FAULT_ANGLE_MISMATCH, 0, FAULT_STALLED}, /* stall test: torque of the rotating vector contradicts the rotor angle */
    [FINDING_PHASE_NO_CURRENT] = {FAULT_PHASE_LOST, CURRENT_SENSE, 0}, /* no current in one phase while the others conduct */
    [FINDING_CURRENT_NOT_FOLLOWING] = {FAULT_PHASE_LOST, CURRENT_SENSE, 0}, /* voltage or test current requested, but no current flows */
    [FINDING_SEARCH_LOW_CURRENT] = {FAULT_PHASE_LOST, CURRENT_SENSE, FAULT_ROTOR_SEARCH}, /* rotor search: less than a quarter of the requested current flows */
    [FINDING_SEARCH_END_NO_CURRENT] = {FAULT_PHASE_LOST, 0, FAULT_ROTOR_SEARCH}, /* rotor search ended without movement, no current flows */
    [FINDING_START_UP_NO_CURRENT] = {FAULT_PHASE_LOST, 0, FAULT_START_UP}, /* sensorless start-up failed, no current flows */
    [FINDING_CURRENT_SENSE_FAILED] = {FAULT_CURRENT_SENSE, 0, 0}, /* ADC code off its offset without current, or constant while the others are noisy */
    [FINDING_LOOPS_LATE] = {FAULT_LATE_LOOP, 0, 0}, /* more than two control loops late or omitted within 32 ms */
    [FINDING_WATCHDOG_RESET] = {FAULT_WATCHDOG, 0, 0}, /* the watchdog has reset the board */
    [FINDING_HOMING_FAILED] = {FAULT_HOMING, 0, 0}, /* homing: no stop or switch found in time, found at different positions, or a stop that holds the shaft */
    [FINDING_ENABLE_OPEN] = {FAULT_ENABLE_INPUT, 0, 0}, /* enable input opened in RUN, or open when RUN was requested */
    [FINDING_LIMIT_SWITCH] = {FAULT_LIMIT_SWITCH, 0, 0}, /* in motion: limit switch reached, or its wire broken */
};

/* Causes that explain other findings, in order of priority. */
PROGRAM_TABLE fault_cause_t fault_causes[FAULT_CAUSES] = {
    {CURRENT_SENSE, FAULT_CURRENT_SENSE}, /* two samples of a converter off its offset, or six equal codes while the others are noisy */
    {PHASE, FAULT_PHASE_LOST}, /* one phase without current for two ticks or in three octants, or eight ticks of voltage without current */
    {ENCODER, FAULT_ENCODER_LOST}, /* the count stopped abruptly and READY has shorted the windings */
    {ANGLE, FAULT_ANGLE_MISMATCH}, /* the voltage error exceeds the expected back-EMF */
};

/* Faults derived from currents: void if the current feedback turns out to be invalid. */
#define CURRENT_DERIVED_FAULTS                                                                                         \
    (FAULT_CURRENT_OFFSET | FAULT_ROTOR_SEARCH | FAULT_ENCODER_LOST | FAULT_ENCODER_REVERSED | FAULT_ANGLE_MISMATCH |  \
     FAULT_PHASE_LOST | FAULT_SPEED_FEEDBACK | FAULT_START_UP)

/* Causes that are detected after their consequence. `within` [PWM periods]: a converter that repeats its code is
 * detected within 128 ms; late loops that the port detects are counted once per slow tick, the over-current that they
 * cause trips immediately. */
PROGRAM_TABLE fault_revision_rule_t fault_revisions[FAULT_REVISIONS] = {
    {FAULT_CURRENT_SENSE, 2048, CURRENT_DERIVED_FAULTS | FAULT_OVER_CURRENT, CURRENT_DERIVED_FAULTS}, /* current feedback invalid; faults derived from it are void */
    {FAULT_LATE_LOOP, 16, FAULT_OVER_CURRENT, 0}, /* duty cycles were frozen while the shaft turned on */
};
/* clang-format on */
