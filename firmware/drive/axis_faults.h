/* axis_faults.h - response of the axis to findings: isolate and capture the faults, then stop. */
#ifndef SERVO_DRIVE_AXIS_FAULTS_H
#define SERVO_DRIVE_AXIS_FAULTS_H

#include "drive/axis_data.h"
#include "drive/sensorless_estimate.h"

/* Copy present state and measurements to the observation, for the fault record and the isolation. */
static inline void axis_observe(axis_t *axis)
{
    observation_t *o = &axis->observation;
    const bool runs = axis->sm.state == STATE_RUN;
    o->shorted = runs && axis->substate == SUBSTATE_READY;
    o->sensorless = axis->sensorless;
    o->u_dc = (frac16_t)asr32(axis->u_dc_now, 16);
    o->theta_e = axis->feedback.theta_e;
    o->speed = axis->feedback.speed;
    o->current = axis->current_loop.current;
    o->emf = sensorless_estimate_emf_at(axis, axis->current_loop.omega_e);
}

/* Isolate and capture findings. The outputs are switched off with the next call of the state machine, or after a
 * stop if the configuration has a stop category for all of these faults (stop.h). */
void axis_raise(axis_t *axis, finding_set_t findings);

/* axis_raise for findings that are relevant only while the axis is enabled (host silence). */
void axis_stop_with(axis_t *axis, finding_set_t findings);

#endif
