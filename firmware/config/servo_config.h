/* servo_config.h - the configuration computed from servo.toml. Only the owner of a board selects it: the servo gets its
 * configuration from servo_init.
 */
#ifndef SERVO_CONFIG_SERVO_CONFIG_H
#define SERVO_CONFIG_SERVO_CONFIG_H

#include "config/axis_config.h"

extern const servo_config_t servo_config;

#endif
