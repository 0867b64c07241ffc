/* ripple_forward.h - feed-forward current against torque ripple from the mechanical angle (control/torque_ripple.h). */
#ifndef SERVO_DRIVE_RIPPLE_FORWARD_H
#define SERVO_DRIVE_RIPPLE_FORWARD_H

#include "drive/axis_data.h"

/* Once per slow tick, two PWM periods before the slow loop that uses the current: the sines do not fit its period. */
void ripple_forward_step(axis_t *axis);

#endif
