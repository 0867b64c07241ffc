/* axis_faults.h - from a finding to what the axis does about it: name and capture it, then stop. */
#ifndef SERVO_DRIVE_AXIS_FAULTS_H
#define SERVO_DRIVE_AXIS_FAULTS_H

#include "drive/axis_data.h"
#include "drive/sensorless_estimate.h"

/* State and measurements of this moment go into the observation: what is recorded, and what separates cause from
 * consequence. */
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

/* Name and capture findings. The outputs go off with the next call of the state machine, or after a stop where the
 * configuration has one for all of these faults (stop.h). */
void axis_raise(axis_t *axis, finding_set_t findings);

/* The same, for what concerns an axis only while its drive is wanted (host silence). */
void axis_stop_with(axis_t *axis, finding_set_t findings);

#endif
