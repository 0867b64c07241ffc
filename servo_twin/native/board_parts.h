/* board_parts.h - functions of the two levels of a board that their common part (board.c) calls. */
#ifndef SERVO_TWIN_BOARD_PARTS_H
#define SERVO_TWIN_BOARD_PARTS_H

#include <stdbool.h>

#include "app/servo.h"
#include "board.h"
#include "flash.h"

/* The configuration of the servo of a new board. */
void board_servo_config(const board_config_t *config, servo_config_t *servo);

/* The servo, after its boot. */
servo_t *board_servo(board_t *board);

/* board_advance, at most to the next slow tick. True if it has stopped there. */
bool board_run_to_tick(board_t *board, uint64_t until_ns);

/* Injected faults: cut wire (board_pin_t), stalled core [s], faults of the plant. */
void board_cut_wire(board_t *board, int axis, int pin, bool cut);
void board_stall_core(board_t *board, double seconds);
void board_set_plant_fault(board_t *board, const board_fault_t *fault, bool cleared);

/* Temperature of a winding of the plant from now on [deg C]. */
void board_warm_winding(board_t *board, int axis, double celsius);

/* The data flash, and the present time [ns]. */
flash_t *board_flash(board_t *board, uint64_t *now_ns);

#endif
