/* measurement_data.h - values that the board restores at the end of a measurement (app/measurement.h). */
#ifndef SERVO_APP_MEASUREMENT_DATA_H
#define SERVO_APP_MEASUREMENT_DATA_H

#include "math/frac.h"

typedef struct {
    uint32_t checksum; /* checksum of the configuration block at the beginning */
    frac32_t speed; /* cmd.speed at the beginning, Q1.31 of full-scale speed */
    frac16_t i_q; /* cmd.i_q at the beginning, Q1.15 of full-scale current */
    uint16_t mode; /* cmd.mode at the beginning, control_mode_t */
    uint16_t axis; /* index of the axis */
    bool enabled; /* the axis was enabled at the beginning */
    bool stops; /* the axis is disabled before the values are restored */
} measurement_t;

#endif
