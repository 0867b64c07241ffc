/* path_units.h - conversion between speed fractions and steps of the path filter. */
#ifndef SERVO_DRIVE_PATH_UNITS_H
#define SERVO_DRIVE_PATH_UNITS_H

#include "config/axis_config.h"
#include "control/path_filter.h"

/* Speed (31 fraction bits) to counts with 24 fraction bits per slow tick; path_step_per_speed has 16 fraction bits. */
static inline path_position_t path_step_of(const axis_config_t *config, frac32_t speed)
{
    return asr64((int64_t)speed * config->path_step_per_speed, 31 - (PATH_BITS - 16));
}

static inline frac32_t path_speed_of(const axis_config_t *config, path_position_t step)
{
    return sat32(asr64(step * config->speed_per_path_step, PATH_BITS));
}

#endif
