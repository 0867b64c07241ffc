/* board_parts.h - functions of the two levels of a board that their common part (board.c) calls. */
#ifndef SERVO_TWIN_BOARD_PARTS_H
#define SERVO_TWIN_BOARD_PARTS_H

#include <stdbool.h>
#include <string.h>

#include "app/servo.h"
#include "board.h"
#include "comm/recorder.h"
#include "flash.h"
#include "plant/driven_shaft.h"
#include "plant/pins.h"

/* A part of struct board that its image leaves out. Of a ring buffer the image contains the bytes in use. */
typedef struct {
    size_t offset, size; /* [bytes] */
    size_t ring_head,
        ring_used; /* where the index of the first byte in use and their number are (size_t); 0: no ring buffer */
} board_gap_t;

/* struct board, for board_state.c; pointers and gaps are in ascending order. */
typedef struct {
    size_t size; /* [bytes] */
    const size_t *pointer; /* offset of every pointer */
    size_t pointers;
    const board_gap_t *gap;
    size_t gaps;
    uint64_t build; /* identity of sources, compiler and options */
} board_layout_t;

extern const board_layout_t board_layout;

/* Go on to an instant at which the board is nothing but the data in it. NULL, or why there is none. */
const char *board_rest(board_t *board);

/* The data of the board have been replaced by those of such an instant. */
void board_restored(board_t *board);

/* The configuration of the servo of a new board. */
void board_servo_config(const board_config_t *config, servo_config_t *servo);

/* The servo, after its boot. */
servo_t *board_servo(board_t *board);

/* Variables of a program, read at the end of a loop without taking time: its own recorder has its own memory only. */
typedef struct {
    const uint8_t *source[RECORDER_SLOTS];
    uint8_t size[RECORDER_SLOTS]; /* [bytes] */
    uint16_t cells;
    int recorder; /* of the loop: 0 fast, 1 slow */
    uint8_t *samples; /* ring buffer of the host; NULL: no sampling */
    uint32_t point; /* [bytes] */
    uint32_t points; /* capacity */
    uint32_t next; /* index of the next point */
    bool filled;
} board_sampler_t;

static inline void board_sampler_take(board_sampler_t *sampler, int recorder)
{
    if (sampler->samples == NULL || sampler->recorder != recorder) {
        return;
    }
    uint8_t *to = sampler->samples + (size_t)sampler->next * sampler->point;
    for (uint16_t k = 0; k < sampler->cells; k++) {
        memcpy(to, sampler->source[k], sampler->size[k]);
        to += sampler->size[k];
    }
    sampler->next++;
    if (sampler->next == sampler->points) {
        sampler->next = 0;
        sampler->filled = true;
    }
}

/* NULL if the software is linked: then its recorder samples. */
board_sampler_t *board_sampler(board_t *board);

/* Place of a variable of the program. FreeMASTER status: FM_BUSY while the program starts. */
uint8_t board_program_place(board_t *board, uint32_t address, uint16_t size, const uint8_t **place);

/* Identity of the program that is executed instead of that servo; 0: none. */
uint64_t board_program_identity(const board_t *board);

/* Functions of the software, whichever it is: servo_read, servo_write, the snapshot, the estimate of a winding. */
uint8_t board_software_read(board_t *board, uint32_t address, uint8_t *data, uint16_t size);
uint8_t board_software_write(board_t *board, uint32_t address, const uint8_t *data, uint16_t size);
const void *board_software_snapshot(board_t *board);
/* FreeMASTER status: FM_BUSY while a program starts. */
uint8_t board_software_set_winding(board_t *board, int axis, frac32_t temperature);

/* board_advance, at most to the next slow tick. True if it has stopped there. */
bool board_run_to_tick(board_t *board, uint64_t until_ns);

/* Injected faults: cut wire (board_pin_t), stalled core [s], faults of the plant. */
void board_cut_wire(board_t *board, int axis, int pin, bool cut);
void board_stall_core(board_t *board, double seconds);

#define BOARD_NO_BROWN_OUT "a brown-out is modelled for the board odrive36 that executes an ELF file only"
void board_set_plant_fault(board_t *board, const board_fault_t *fault, bool cleared);

/* Drive the shaft of an axis without a second mass: parameters as board_drive_shaft. */
void board_drive_rotor(board_t *board, int axis, double theta, double omega, double seconds);
bool board_has_second_mass(const board_t *board, int axis);
driven_shaft_t *board_driven_shaft(board_t *board, int axis);
const plant_pins_t *board_plant_pins(const board_t *board, int axis);

/* Temperature of a winding of the plant from now on [deg C]. */
void board_warm_winding(board_t *board, int axis, double celsius);

/* The data flash, and the present time [ns]. */
flash_t *board_flash(board_t *board, uint64_t *now_ns);

#endif
