#include <stdlib.h>
#include <string.h>

#include "app/servo.h"
#include "app/variables.h"
#include "board.h"
#include "registers/register_chip.h"

#define NS_PER_CLOCK 10u

struct board {
    servo_t servo;
    register_chip_t chip;
};

board_t *board_new(const board_config_t *config)
{
    board_t *board = (board_t *)calloc(1, sizeof *board);
    if (board != NULL) {
        register_chip_init(&board->chip, config, &board->servo);
        (void)register_chip_run(&board->chip, 0, false); /* the software boots */
    }
    return board;
}

void board_free(board_t *board) { free(board); }

static uint64_t clock_of(uint64_t ns) { return ns / NS_PER_CLOCK; }

void board_advance(board_t *board, uint64_t until_ns)
{
    (void)register_chip_run(&board->chip, clock_of(until_ns), false);
}

uint64_t board_time_ns(const board_t *board) { return board->chip.chip.now * NS_PER_CLOCK; }

size_t board_record(board_t *board, uint64_t until_ns, uint8_t *log, size_t max_rows)
{
    const size_t size = sizeof board->servo.snapshot;
    size_t rows = 0;
    while (rows < max_rows) {
        const uint32_t tick = board->servo.snapshot.tick;
        if (!register_chip_run(&board->chip, clock_of(until_ns), true)) {
            break;
        }
        if (board->servo.snapshot.tick != tick) {
            memcpy(log + rows * size, &board->servo.snapshot, size);
            rows++;
        }
    }
    return rows;
}

size_t board_snapshot_size(void) { return sizeof(snapshot_t); }

size_t board_serial_in(board_t *board, const uint8_t *data, size_t size)
{
    return chip_line_write(&board->chip.chip, data, size);
}

size_t board_serial_out(board_t *board, uint8_t *data, size_t room)
{
    return chip_line_read(&board->chip.chip, data, room);
}

uint64_t board_serial_next_ns(const board_t *board)
{
    const uint64_t clock = chip_line_next(&board->chip.chip);
    return (clock == CHIP_NEVER) ? UINT64_MAX : clock * NS_PER_CLOCK;
}

uint8_t board_read(board_t *board, uint32_t address, uint8_t *data, uint16_t size)
{
    return servo_read(&board->servo, address, data, size);
}

uint8_t board_write(board_t *board, uint32_t address, const uint8_t *data, uint16_t size)
{
    return servo_write(&board->servo, address, data, size);
}

void board_table(uint32_t *address, uint32_t *size)
{
    *address = TSA_TABLE_BASE;
    *size = tsa_table_size(&servo_variables);
}

void board_truth(const board_t *board, int axis, board_truth_t *truth)
{
    switching_truth_t state;
    switching_bus_t bus;
    switching_truth(&board->chip.plant, axis, &state);
    switching_bus(&board->chip.plant, &bus);
    *truth = (board_truth_t){
        .theta_m = state.theta,
        .omega_m = state.omega,
        .i_d = state.i_d,
        .i_q = state.i_q,
        .torque_e = state.torque,
        .u_a = state.voltage[0] - 0.5 * bus.u_dc,
        .u_b = state.voltage[1] - 0.5 * bus.u_dc,
        .u_c = state.voltage[2] - 0.5 * bus.u_dc,
        .u_dc = bus.u_dc,
    };
}

void board_stats(const board_t *board, board_stats_t *stats)
{
    *stats = (board_stats_t){
        .serial_overruns = board->chip.chip.line.overruns,
        .serial_lost = board->chip.chip.line.lost,
        .breaks = board->chip.breaks,
        .watchdog_services = board->chip.chip.cop.services,
    };
}

void board_set_load(board_t *board, int axis, double torque) { switching_set_load(&board->chip.plant, axis, torque); }

void board_set_supply(board_t *board, double volts) { switching_set_supply(&board->chip.plant, volts); }

void board_set_shaft(board_t *board, int axis, int locked) { switching_lock(&board->chip.plant, axis, locked != 0); }

void board_set_encoder(board_t *board, int axis, int connected)
{
    switching_cut(&board->chip.plant, axis, 0, connected == 0);
    switching_cut(&board->chip.plant, axis, 1, connected == 0);
}

void board_cut_encoder(board_t *board, int axis, int line) { switching_cut(&board->chip.plant, axis, line, true); }

void board_set_motor(board_t *board, int axis, int connected)
{
    switching_plug(&board->chip.plant, axis, connected != 0);
}

const char *board_error(const board_t *board) { return board->chip.chip.failed ? board->chip.chip.error : NULL; }
