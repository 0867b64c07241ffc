/* board_parts.h - what the two levels of a board offer to the part that they share. */
#ifndef SERVO_TWIN_BOARD_PARTS_H
#define SERVO_TWIN_BOARD_PARTS_H

#include "app/servo.h"
#include "board.h"
#include "flash.h"

servo_t *board_servo(board_t *board);

/* The data flash, and the present on its clock. */
flash_t *board_flash(board_t *board, uint64_t *now_ns);

#endif
