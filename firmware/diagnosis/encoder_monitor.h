/* encoder_monitor.h - detects an encoder that does not count.
 *
 * One dead channel: the count alternates by one with the edges of the other channel, faster than a shaft at rest can
 * dither. Two dead channels: the count is constant while the voltage rotates like a back-EMF.
 */
#ifndef SERVO_DIAGNOSIS_ENCODER_MONITOR_H
#define SERVO_DIAGNOSIS_ENCODER_MONITOR_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

/* Slow ticks without movement after an abrupt stop of the count, before the probe begins. */
#define ENCODER_CONFIRM_TICKS 20U

typedef struct {
    int32_t reference_count; /* movement: the count leaves it by more than two */
    int32_t last_count; /* previous slow tick */
    uint16_t ticks_without_movement; /* slow ticks since the last movement */

    /* toggle test: a count that alternates by one */
    uint16_t window_ticks; /* slow ticks of the present window */
    uint16_t window_changes; /* slow ticks of the present window in which the count changed */
    int32_t last_change; /* last change of the count, counts */
    bool not_alternating; /* a change in the present window did not reverse the previous one */
    uint8_t alternating_windows; /* consecutive windows with more alternating changes than a shaft at rest causes */

    /* abrupt stop */
    uint16_t step_counts; /* counts of the last slow tick with movement, in which the shaft may have stopped */
    uint16_t earlier_step_counts; /* counts of the slow tick before */
    bool stopped_abruptly; /* the count stopped from a high speed within two slow ticks */

    /* unexplained voltage at a constant count */
    frac16_t last_i_q_ref; /* i_q* of the previous slow tick, Q1.15 of full-scale current */
    dq_t unexplained_voltage; /* voltage minus the resistive drop, filtered, Q1.15 of full-scale voltage */
    /* slow ticks with unexplained voltage, minus those without (READY: consecutive slow ticks with current) */
    uint16_t unexplained_ticks;
    uint16_t ticks_without_current; /* slow ticks among `unexplained_ticks` without current */
    uint16_t windup_ticks; /* consecutive slow ticks with a voltage so high that the current cannot follow */
    dq_t reference_voltage; /* unexplained voltage, or integrator outputs in a probe, at the start of the observation */
    uint32_t expected_rotation; /* rotation of a back-EMF of that amplitude since then, 2^16 is one turn */
    bool direction_changed; /* the voltage has rotated by more than an eighth of a turn since then */
    bool direction_was_constant; /* the direction was constant for longer than that of a back-EMF */

    /* test current */
    uint8_t test_ticks; /* slow ticks since the test current was requested; 0: no test */
    bool along_q; /* test current on the q axis, otherwise on the d axis */
    bool negative_q; /* negative test current, because i_q* may be at its limit */
    frac16_t current_before_test; /* current on the test axis before the test, Q1.15 of full-scale current */

    /* probe after an abrupt stop: constant current, the voltage changes only if the rotor turns */
    uint16_t probe_ticks; /* slow ticks since the start of the probe; 0: no probe */
    frac16_t i_q_ref_at_probe; /* i_q* at the start, Q1.15 of full-scale current; a change ends the probe */
    uint8_t voltage_change_ticks; /* consecutive slow ticks with a changed voltage */
} encoder_monitor_t;

/* Initialise with the shaft at rest at this count. */
void encoder_monitor_start(encoder_monitor_t *monitor, int32_t count);

/* One slow tick of an axis with an encoder, in every state except FAULT; sets `observation->ticks_without_movement`.
 * `kp`: gain of the q current controller. */
void encoder_monitor_step(encoder_monitor_t *monitor, const winding_config_t *config, gain_t kp,
                          observation_t *observation, evidence_t *evidence);

/* True for ENCODER_CONFIRM_TICKS after an abrupt stop of the count: either the shaft has stopped or the encoder has
 * failed. */
static inline bool encoder_monitor_stop_unconfirmed(const encoder_monitor_t *monitor)
{
    return monitor->stopped_abruptly && monitor->ticks_without_movement < ENCODER_CONFIRM_TICKS;
}

/* Suspect the encoder if the count stopped abruptly and the windings are shorted. */
void encoder_monitor_suspect(const encoder_monitor_t *monitor, const observation_t *observation, evidence_t *evidence);

#endif
