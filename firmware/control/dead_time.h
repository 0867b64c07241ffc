/* dead_time.h - compensation of dead time and switch drops.
 *
 * With both switches open the current chooses the diode, and every conducting path drops some volts: the mean phase
 * voltage is short of the duty by (t_d f + V_drop / u_dc) u_dc against the direction of the current. Around zero current
 * the direction is uncertain within the ripple, so the sign is softened to a ramp.
 */
#ifndef SERVO_CONTROL_DEAD_TIME_H
#define SERVO_CONTROL_DEAD_TIME_H

#include "control/transforms.h"

typedef struct {
    frac16_t duty;   /* t_d f */
    frac16_t v_drop; /* over the full-scale bus */
    gain_t slope;    /* full-scale current over the current at which the sign is certain */
} dead_time_config_t;

/* Duties that give the wanted mean voltages; `reciprocal` is 2^29 / u_dc (Q1.15 of the full-scale bus). */
abc_t dead_time_compensate(const dead_time_config_t *config, abc_t duty, abc_t current, int32_t reciprocal);

#endif
