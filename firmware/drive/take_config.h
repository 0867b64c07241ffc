/* take_config.h - change of the configuration of an axis, between two slow ticks. */
#ifndef SERVO_DRIVE_TAKE_CONFIG_H
#define SERVO_DRIVE_TAKE_CONFIG_H

#include "drive/axis_data.h"

/* True if any member may change: the axis is at rest with its outputs off. */
bool axis_takes_any_config(const axis_t *axis);

/* Use `config`, which must stay valid. Bumpless in motion: integrators compensate the change of the other terms;
 * position gain and path filter approach their new values. */
void axis_take_config(axis_t *axis, const axis_config_t *config);

#endif
