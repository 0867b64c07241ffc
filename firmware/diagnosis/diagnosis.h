/* diagnosis.h - states of all monitors of one axis, and their suspicions. drive/monitors.h calls the monitors. */
#ifndef SERVO_DIAGNOSIS_DIAGNOSIS_H
#define SERVO_DIAGNOSIS_DIAGNOSIS_H

#include "diagnosis/angle_monitor.h"
#include "diagnosis/bus_monitor.h"
#include "diagnosis/current_sense_monitor.h"
#include "diagnosis/encoder_monitor.h"
#include "diagnosis/heat_sink_monitor.h"
#include "diagnosis/oscillation_monitor.h"
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
    oscillation_monitor_t oscillation;
    stall_test_t stall;
    evidence_t evidence; /* findings and suspicions of this slow tick so far */
} diagnosis_t;

/* Add the suspicions of all monitors to the evidence. Needed only if a finding is confirmed. */
void diagnosis_suspect(const diagnosis_t *diagnosis, const winding_config_t *config, const observation_t *observation,
                       evidence_t *evidence);

#endif
