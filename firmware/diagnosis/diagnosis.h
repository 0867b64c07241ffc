/* diagnosis.h - the monitors of one axis. The drive calls them one by one; here stands what all of them suspect. */
#ifndef SERVO_DIAGNOSIS_DIAGNOSIS_H
#define SERVO_DIAGNOSIS_DIAGNOSIS_H

#include "diagnosis/angle_monitor.h"
#include "diagnosis/bus_monitor.h"
#include "diagnosis/current_sense_monitor.h"
#include "diagnosis/encoder_monitor.h"
#include "diagnosis/heat_sink_monitor.h"
#include "diagnosis/phase_monitor.h"
#include "diagnosis/shaft_monitor.h"
#include "diagnosis/stall_test.h"
#include "diagnosis/winding_model.h"

typedef struct {
    bus_monitor_t bus;
    current_sense_monitor_t current_sense;
    phase_monitor_t phase;
    encoder_monitor_t encoder;
    angle_monitor_t angle;
    heat_sink_monitor_t heat_sink;
    winding_model_t winding;
    shaft_monitor_t shaft;
    stall_test_t stall;
    evidence_t evidence; /* of this slow tick, as far as it is there */
} diagnosis_t;

/* Add what the monitors suspect to what has been confirmed. Needed only once something has. */
void diagnosis_suspect(const diagnosis_t *diagnosis, const winding_config_t *config, const observation_t *observation,
                       evidence_t *evidence);

#endif
