#include "diagnosis/fault_rules.h"

#include "config/contract_gen.h"

/* ---- the priority table -------------------------------------------------------------------------------------------
 *
 * A row per finding, in the order of priority. It is called `fault`, unless one of the suspicions `instead` explains it:
 * then it is called what `fault_causes` has for that. A name that is not enabled is passed over; `otherwise` is what is left then
 * for a finding that has to stop the axis whatever it is called. firmware/doc/faults.md is generated from these tables.
 */
#define SENSOR SUSPECT_SENSOR
#define PHASE (SUSPECT_PHASE | SUSPECT_CURRENT)
#define SILENCE SUSPECT_PHASE
#define ENCODER SUSPECT_ENCODER
#define ANGLE SUSPECT_ANGLE

/* clang-format off */
PROGRAM_TABLE fault_rule_t fault_rules[FINDINGS] = {
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
    [FINDING_WINDING_HOT] = {FAULT_MOTOR_TEMPERATURE, 0, 0}, /* estimated temperature of the winding, with hysteresis (feature WINDING_MODEL) */
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
    [FINDING_HOMING_FAILED] = {FAULT_HOMING, 0, 0}, /* no stop or switch in time, at several places, or one that holds the shaft */
    [FINDING_ENABLE_OPEN] = {FAULT_ENABLE_INPUT, 0, 0}, /* the enable input has opened in RUN, or while it was asked for */
    [FINDING_LIMIT_SWITCH] = {FAULT_LIMIT_SWITCH, 0, 0}, /* in motion: a limit switch is reached, or its wire is cut */
};

/* What explains other findings, the strongest first. */
PROGRAM_TABLE fault_cause_t fault_causes[FAULT_CAUSES] = {
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
PROGRAM_TABLE fault_revision_rule_t fault_revisions[FAULT_REVISIONS] = {
    {FAULT_CURRENT_SENSE, 2048, CURRENT_DERIVED_FAULTS | FAULT_OVER_CURRENT, CURRENT_DERIVED_FAULTS}, /* current feedback invalid; faults derived from it are void */
    {FAULT_LATE_LOOP, 16, FAULT_OVER_CURRENT, 0}, /* duties stood still while the shaft went on */
};
/* clang-format on */
