/* ripple_forward.h - feed-forward current against torque ripple from the mechanical angle (control/torque_ripple.h). */
#ifndef SERVO_DRIVE_RIPPLE_FORWARD_H
#define SERVO_DRIVE_RIPPLE_FORWARD_H

#include "drive/axis_data.h"

/* Once per slow tick, two PWM periods before the slow loop that uses the current: the sines do not fit its period. */
void ripple_forward_step(axis_t *axis);

/* The angle or the harmonics change: fade in from 0. The integrator of the speed controller keeps the present current, so
 * that there is no step. */
void ripple_forward_restart(axis_t *axis);

/* ripple_forward_restart if the harmonics of `config` differ, before it takes effect. */
void ripple_forward_retune(axis_t *axis, const axis_config_t *config);

#endif
