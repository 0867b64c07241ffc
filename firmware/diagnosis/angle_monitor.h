/* angle_monitor.h - does the back-EMF lie where the encoder says?
 *
 * What the current controllers ask of the inverter is the voltage of the windings, with the back-EMF where the encoder has
 * it. More than that is a back-EMF that points elsewhere: the encoder has slipped. It shows in motion, as soon as the
 * back-EMF is larger than what resistance and dead time may be off by, and at no cost to the fast loop. The observer of
 * FEATURE_ANGLE_CHECK sees it sooner, and with less current.
 */
#ifndef SERVO_DIAGNOSIS_ANGLE_MONITOR_H
#define SERVO_DIAGNOSIS_ANGLE_MONITOR_H

#include "control/current_loop.h"
#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

typedef struct {
    dq_t unexplained_voltage;         /* voltage that nothing explains, filtered */
    uint16_t ticks;      /* slow ticks of too much of it, less those without */
    uint16_t conducting_phases; /* phases that have carried current since it began, a bit each */
} angle_monitor_t;

/* The rotor has just been found. */
void angle_monitor_start(angle_monitor_t *monitor);

/* One slow tick of current control with the encoder's angle. */
void angle_monitor_step(angle_monitor_t *monitor, const winding_config_t *config, const current_loop_config_t *loop,
                        const observation_t *observation, evidence_t *evidence);

/* The back-EMF is missed by more than its size: a resistance whose drop is larger had kept the monitor in doubt. A
 * resistance that is off by as much looks the same. */
void angle_monitor_suspect(const angle_monitor_t *monitor, const winding_config_t *config,
                           const observation_t *observation, evidence_t *evidence);

#endif
