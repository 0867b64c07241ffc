/* The board with the ideal chip and the averaged plant. */
#include "board_ideal.h"

#include <stdlib.h>

#include "comm/status.h"

board_t *board_new(const board_config_t *config)
{
    board_t *board = (board_t *)calloc(1, sizeof *board);
    if (board != NULL) {
        board_servo_config(config, &board->config);
        chip_init(&board->chip, config, &board->servo, &board->config);
        servo_init(&board->servo, &board->chip, &board->config);
    }
    return board;
}

void board_free(board_t *board) { free(board); }

flash_t *board_flash(board_t *board, uint64_t *now_ns)
{
    *now_ns = board->chip.now_ns;
    return &board->chip.flash;
}

servo_t *board_servo(board_t *board) { return &board->servo; }

board_sampler_t *board_sampler(board_t *board)
{
    (void)board;
    return NULL;
}

uint8_t board_program_place(board_t *board, uint32_t address, uint16_t size, const uint8_t **place)
{
    (void)board;
    (void)address;
    (void)size;
    (void)place;
    return FM_DENIED;
}

uint64_t board_program_identity(const board_t *board)
{
    (void)board;
    return 0;
}

uint8_t board_software_read(board_t *board, uint32_t address, uint8_t *data, uint16_t size)
{
    return servo_read(&board->servo, address, data, size);
}

uint8_t board_software_write(board_t *board, uint32_t address, const uint8_t *data, uint16_t size)
{
    return servo_write(&board->servo, address, data, size);
}

const void *board_software_snapshot(board_t *board) { return &board->servo.snapshot; }

uint8_t board_software_set_winding(board_t *board, int axis, frac32_t temperature)
{
    board->servo.axis[axis].diagnosis.winding.temperature = temperature;
    return FM_OK;
}

const char *board_error(const board_t *board) { return plant_too_fast(&board->chip.plant) ? SHAFT_TOO_FAST : NULL; }

void board_advance(board_t *board, uint64_t until_ns) { (void)chip_run(&board->chip, until_ns, false); }

uint64_t board_time_ns(const board_t *board) { return board->chip.now_ns; }

bool board_run_to_tick(board_t *board, uint64_t until_ns)
{
    const uint32_t tick = board->servo.snapshot.tick;
    while (chip_run(&board->chip, until_ns, true)) {
        if (board->servo.snapshot.tick != tick) {
            return true;
        }
    }
    return false;
}

size_t board_serial_in(board_t *board, const uint8_t *data, size_t size)
{
    return uart_host_write(&board->chip.uart, data, size, board->chip.now_ns);
}

size_t board_serial_out(board_t *board, uint8_t *data, size_t room)
{
    return uart_host_read(&board->chip.uart, data, room);
}

uint64_t board_serial_next_ns(const board_t *board) { return uart_next_ns(&board->chip.uart); }

static plant_drive_t *drive_of(board_t *board, int axis) { return &board->chip.plant.axis[axis]; }

void board_truth(const board_t *board, int axis, board_truth_t *truth)
{
    const plant_drive_t *drive = &board->chip.plant.axis[axis];
    double voltage[3];
    plant_voltages(&board->chip.plant, axis, voltage);
    *truth = (board_truth_t){
        .theta_m = drive->motor.theta,
        .omega_m = drive->motor.omega,
        .i_d = drive->motor.i_d,
        .i_q = drive->motor.i_q,
        .torque_e = plant_motor_torque(&drive->motor),
        .impulse_e = drive->impulse,
        .u_a = voltage[0],
        .u_b = voltage[1],
        .u_c = voltage[2],
        .t_sink = drive->sink.t,
        .t_winding = drive->winding.t,
        .brake_holds = drive->pins.holds ? 1.0 : 0.0,
        .u_dc = board->chip.plant.bus.u,
        .e_brake = board->chip.plant.bus.e_brake,
        .t_brake = board->chip.plant.bus.brake_resistor.t,
        .theta_load = drive->shaft.two_masses ? drive->shaft.theta : drive->motor.theta,
        .omega_load = drive->shaft.two_masses ? drive->shaft.omega : drive->motor.omega,
        .torque_shaft = drive->shaft.two_masses ? drive->shaft.torque : 0.0,
        .t_magnet = drive->t_magnet,
        .r_s = plant_resistance(drive),
        .psi_m = drive->motor.psi_m,
        .l_d = 1.0 / drive->motor.inv_l_d,
        .l_q = 1.0 / drive->motor.inv_l_q,
    };
}

void board_stats(const board_t *board, board_stats_t *stats)
{
    *stats = (board_stats_t){
        .serial_overruns = board->chip.uart.overruns,
        .serial_lost = board->chip.uart.tx_lost,
        .breaks = board->chip.breaks,
        .watchdog_services = board->chip.watchdog,
    };
}

void board_change_plant(board_t *board, const board_config_t *config) { plant_change(&board->chip.plant, config); }

void board_set_load(board_t *board, int axis, double torque) { plant_set_load(&board->chip.plant, axis, torque); }

void board_set_supply(board_t *board, double volts) { supply_set(&board->chip.plant.bus, volts); }

void board_set_shaft(board_t *board, int axis, int locked)
{
    plant_motor_lock(&drive_of(board, axis)->motor, locked != 0);
}

void board_obstruct_shaft(board_t *board, int axis, double below, double above)
{
    plant_motor_obstruct(&drive_of(board, axis)->motor, below, above);
}

void board_drive_rotor(board_t *board, int axis, double theta, double omega, double seconds)
{
    hal_t *chip = &board->chip;
    const uint64_t reached = (chip->grid_ns > 0) ? chip->grid_ns - chip->plant.step_ns : 0u; /* by the plant */
    plant_drive_shaft(&chip->plant, axis, theta, omega, seconds, 1e-9 * (double)(chip->now_ns - reached));
}

void board_release_shaft(board_t *board, int axis) { plant_release_shaft(&board->chip.plant, axis); }

bool board_has_second_mass(const board_t *board, int axis) { return board->chip.plant.axis[axis].shaft.two_masses; }

driven_shaft_t *board_driven_shaft(board_t *board, int axis) { return &drive_of(board, axis)->driven; }

const plant_pins_t *board_plant_pins(const board_t *board, int axis) { return &board->chip.plant.axis[axis].pins; }

void board_reverse_encoder(board_t *board, int axis)
{
    plant_drive_t *drive = drive_of(board, axis);
    plant_encoder_reverse(&drive->encoder, drive->motor.theta);
}

void board_set_encoder(board_t *board, int axis, int connected)
{
    plant_drive_t *drive = drive_of(board, axis);
    plant_encoder_connect(&drive->encoder, connected != 0, drive->motor.theta);
}

void board_cut_encoder(board_t *board, int axis, int line)
{
    plant_encoder_stick(&drive_of(board, axis)->encoder, (line == 0) ? PLANT_LINE_A : PLANT_LINE_B, true, false);
}

void board_warm_winding(board_t *board, int axis, double celsius) { drive_of(board, axis)->winding.t = celsius; }

void board_set_magnet(board_t *board, int axis, double celsius) { drive_of(board, axis)->t_magnet = celsius; }

void board_set_motor(board_t *board, int axis, int connected)
{
    plant_drive_t *drive = drive_of(board, axis);
    averaged_inverter_plug(&drive->inverter, &drive->motor, connected != 0);
}

void board_cut_wire(board_t *board, int axis, int pin, bool cut) { chip_cut_wire(&board->chip, axis, pin, cut); }

void board_stall_core(board_t *board, double seconds)
{
    board->chip.stalled_ns = board->chip.now_ns + (uint64_t)(seconds * 1e9);
}

const char *board_brown_out(board_t *board, double seconds)
{
    (void)board;
    (void)seconds;
    return BOARD_NO_BROWN_OUT;
}

void board_set_plant_fault(board_t *board, const board_fault_t *fault, bool cleared)
{
    plant_set_fault(&board->chip.plant, fault, cleared);
}

/* ---- registers: there are none ------------------------------------------------------------------------------------ */

size_t board_trace(board_t *board, uint64_t until_ns, trace_entry_t *log, size_t room)
{
    (void)log;
    (void)room;
    board_advance(board, until_ns);
    return 0;
}

int32_t board_peek(board_t *board, uint32_t address)
{
    (void)board;
    (void)address;
    return -1;
}

int board_poke(board_t *board, uint32_t address, uint16_t value)
{
    (void)board;
    (void)address;
    (void)value;
    return -1;
}
