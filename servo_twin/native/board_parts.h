/* board_parts.h - what the two levels of a board offer to the part that they share. */
#ifndef SERVO_TWIN_BOARD_PARTS_H
#define SERVO_TWIN_BOARD_PARTS_H

#include "app/servo.h"
#include "board.h"
#include "flash.h"

servo_t *board_servo(board_t *board);

/* Temperature of a winding of the plant from now on [deg C]. */
void board_warm_winding(board_t *board, int axis, double celsius);

/* The data flash, and the present on its clock. */
flash_t *board_flash(board_t *board, uint64_t *now_ns);

#endif
