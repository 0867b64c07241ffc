/* inputs_data.h - configuration and state of the optional pins of an axis: switches, enable input, holding brake
 * (inputs.h, holding_brake.h). */
#ifndef SERVO_DRIVE_INPUTS_DATA_H
#define SERVO_DRIVE_INPUTS_DATA_H

#include <stdbool.h>
#include <stdint.h>

#include "math/frac.h"

typedef struct {
    uint16_t fitted; /* INPUT_ bits of the fitted pins; INPUT_BRAKE_OPEN: holding brake */
    uint16_t open_ticks; /* opening time of the holding brake, slow ticks */
    uint16_t close_ticks; /* closing time of the holding brake, slow ticks */
} pins_config_t;

typedef struct {
    uint16_t last_levels; /* INPUT_ bits read in the last slow tick, unfiltered */
    uint16_t inactive_ticks; /* slow ticks since a limit switch was active */
} inputs_state_t;

typedef struct {
    bool open_requested; /* opening requested */
    bool powered; /* the coil carries current */
    uint16_t ticks; /* remaining slow ticks of opening or closing */
    frac16_t load; /* i_q that held the shaft at rest before closing, Q1.15 of full-scale current */
} holding_brake_t;

#endif
