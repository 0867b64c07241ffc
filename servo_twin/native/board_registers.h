/* board_registers.h - a board at register level: the common part (board_registers.c) and that of one chip with its circuits
 * (boards/NAME/board_chip.h, board_chip.c), chosen by the include path.
 *
 * board_chip.h gives chip_t with the functions of chip/chip.h for the board; as BOARD_BUS, BOARD_LINE, BOARD_FLASH and BOARD_WATCHDOG
 * where in a chip_t its bus_t, serial_line_t, flash_t and counter of services are; the gaps of its state around those of the line;
 * and board_software_t, the software that is linked with the board, which has at least a member `servo`.
 */
#ifndef SERVO_TWIN_BOARD_REGISTERS_H
#define SERVO_TWIN_BOARD_REGISTERS_H

#include "board_chip.h"
#include "board_clock.h"
#include "board_parts.h"
#include "plant/pins.h"
#include "plant/switching.h"
#include "program.h"

struct board {
    switching_t plant; /* at a multiple of SWITCHING_LINE */
    chip_t chip;
    board_software_t linked;
    servo_config_t config;
    double baud; /* of the serial line [bit/s] */
    uint64_t time_ns; /* since `zero` [ns] */
    uint64_t zero; /* clock at which the first period with loops begins: t0 of DRM F34 */
    bool booted;
    bool starting; /* stop at the start of the sequence of both loops */
    uint32_t breaks; /* times an over-current comparator has tripped */
    uint32_t stall_clocks; /* added to the next control loop, as it would interrupt any other handler [clocks] */
    bool tripped[BOARD_AXES]; /* output of the over-current comparator */
    bool swapped[BOARD_AXES]; /* lines A and B of the encoder are swapped */
    plant_pins_t pins[BOARD_AXES];
    unsigned closed[BOARD_AXES]; /* contacts whose pins are low, a bit per board_pin_t */
    bool recording; /* stop after each slow tick */
    uint32_t tick; /* of the last snapshot */
    board_sampler_t sampler; /* of the program */
    program_t program; /* instead of `linked`, if it is loaded */
};

/* ---- given by board_chip.c ------------------------------------------------------------------------------------------ */

#define BOARD_CONTACTS 4 /* by board_pin_t; all to ground, pulled up */
#define BOARD_NO_PIN (~0u) /* the board has no such pin */

typedef struct {
    unsigned encoder[BOARD_AXES][2]; /* pins of the lines A and B */
    unsigned contact[BOARD_AXES][BOARD_CONTACTS];
    unsigned brake_resistor, holding[BOARD_AXES]; /* outputs, on with a high level */
    unsigned vector_m1, vector_m2; /* of the fast loops */
    unsigned vector_start; /* whose first end starts the sequence of both loops */
    uint32_t boot_clocks; /* of a program, at most */
} board_wiring_t;

extern const board_wiring_t board_wiring;
extern const program_chip_t board_program_chip;

/* Power on. */
void board_chip_init(board_t *board, const board_config_t *config, const chip_environment_t *environment);

/* Members of the environment of the chip. */
void board_set_gates(void *board, unsigned module, unsigned submodule, unsigned levels);
uint16_t board_convert(void *board, unsigned channel);

/* The software that is linked with the board: its boot, the body of an interrupt, the background. */
void board_boot(board_t *board);
void board_interrupt(board_t *board, unsigned vector);
void board_background(board_t *board);
void board_run_linked(board_t *board, uint64_t until);
bool board_timeless(const board_t *board); /* its instructions take no time */
bool *board_stop_resting(board_t *board,
                         bool on); /* end a run when the core rests; where it is written whether it does */
void board_restored_linked(board_t *board);

/* The output of an axis' over-current comparator has changed. */
void board_over_current(board_t *board, int axis, bool tripped);

/* A program has been loaded. */
void board_program_loaded(board_t *board);

/* Clock of time zero, after the start of the sequence. */
uint64_t board_time_zero(const board_t *board);

#endif
