/* inputs_data.h - configuration and state of the optional pins of an axis: switches, enable input, holding brake (inputs.h,
 * holding_brake.h). */
#ifndef SERVO_DRIVE_INPUTS_DATA_H
#define SERVO_DRIVE_INPUTS_DATA_H

#include <stdbool.h>
#include <stdint.h>

#include "math/frac.h"

typedef struct {
    uint16_t fitted; /* INPUT_ bits of the pins that are wired; INPUT_BRAKE_OPEN: a holding brake */
    uint16_t open_ticks; /* slow ticks from its current until the brake holds nothing .. */
    uint16_t close_ticks; /* .. and from the end of the current until it holds */
} pins_config_t;

typedef struct {
    uint16_t last_levels; /* levels of the last slow tick */
    uint16_t inactive_ticks; /* slow ticks since a limit switch was active */
} inputs_state_t;

typedef struct {
    bool open_requested; /* open */
    bool powered; /* its coil has current */
    uint16_t ticks; /* slow ticks until it has followed */
    frac16_t load; /* current that held the shaft at rest before it closed */
} holding_brake_t;

#endif
