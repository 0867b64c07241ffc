/* take_config.h - another configuration for an axis, between two slow ticks. */
#ifndef SERVO_DRIVE_TAKE_CONFIG_H
#define SERVO_DRIVE_TAKE_CONFIG_H

#include "drive/axis_data.h"

/* The axis is at rest with its outputs off: any member may change. */
bool axis_takes_any_config(const axis_t *axis);

/* From now on the axis works with `config`, which stays valid. In motion no set-point and no output jumps: the integral
 * parts take what the other parts of their controllers lose or gain, the position gain and the path filter come to their
 * new values by themselves. */
void axis_take_config(axis_t *axis, const axis_config_t *config);

#endif
