/* board_ideal.h - the data of a board with the ideal chip and the averaged plant. */
#ifndef SERVO_TWIN_BOARD_IDEAL_H
#define SERVO_TWIN_BOARD_IDEAL_H

#include "board_parts.h"
#include "ideal_chip.h"

struct board {
    servo_t servo;
    hal_t chip;
    servo_config_t config;
};

#endif
