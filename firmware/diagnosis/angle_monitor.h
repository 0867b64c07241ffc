/* angle_monitor.h - detects a slipped encoder from the stator voltage.
 *
 * Expected: u = R i + j omega L i + j omega psi_m at the encoder angle. A residual above the tolerances of resistance,
 * inductance and dead time means that the back-EMF has another direction. Works in motion only and needs no observer;
 * FEATURE_ANGLE_CHECK (drive/angle_check.h) responds sooner and at lower current.
 */
#ifndef SERVO_DIAGNOSIS_ANGLE_MONITOR_H
#define SERVO_DIAGNOSIS_ANGLE_MONITOR_H

#include "control/current_loop.h"
#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

typedef struct {
    dq_t unexplained_voltage; /* stator voltage minus the expected one, filtered, Q1.15 of full-scale voltage */
    uint16_t ticks; /* slow ticks with a residual above the tolerances, minus slow ticks without */
    uint16_t conducting_phases; /* one bit per phase that has carried current while `ticks` > 0 */
} angle_monitor_t;

/* Reset after a rotor search. */
void angle_monitor_start(angle_monitor_t *monitor);

/* One slow tick in SPIN with the encoder angle. */
void angle_monitor_step(angle_monitor_t *monitor, const winding_config_t *config, const current_loop_config_t *loop,
                        const observation_t *observation, evidence_t *evidence);

/* Suspect a slipped encoder if the unexplained voltage exceeds the expected back-EMF. This is weaker than the
 * finding, which tolerates a larger resistance error; a resistance error of the same size cannot be distinguished
 * from a slip. */
void angle_monitor_suspect(const angle_monitor_t *monitor, const winding_config_t *config,
                           const observation_t *observation, evidence_t *evidence);

#endif
