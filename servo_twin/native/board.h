/* board.h - one virtual board: firmware, chip and plant. The complete C interface for Python.
 *
 * Only board_advance and the functions based on it advance the simulated time; equal configuration and calls give
 * bit-identical results. No file-scope state: one process can contain many boards, with one thread per board.
 */
#ifndef SERVO_TWIN_BOARD_H
#define SERVO_TWIN_BOARD_H

#include <stddef.h>
#include <stdint.h>

#include "chip/trace.h"

#define BOARD_AXES 2

/* CFFI-BEGIN: the build script hands the lines up to CFFI-END to cffi.cdef */
typedef struct board board_t;

/* Parameters of an axis, SI units (servo_twin/plant.toml). */
typedef struct {
    double r_s;            /* stator resistance [ohm] */
    double l_d, l_q;       /* stator inductances [H] */
    double psi_m;          /* permanent-magnet flux linkage [V s] (electrical) */
    double pole_pairs;     /* pairs [1] */
    double inertia;        /* total inertia [kg m^2] */
    double friction;       /* Coulomb friction [N m] */
    double viscous;        /* viscous friction [N m s] */
    /* the following, up to the end stops, is off at 0 (servo_twin/doc/plant.md) */
    double load_inertia; /* second mass on an elastic shaft; `inertia` is then that of the rotor [kg m^2] */
    double shaft_stiffness; /* [N m/rad] */
    double shaft_damping; /* [N m s] */
    double backlash; /* backlash of the shaft, full width [rad] */
    double load_friction; /* Coulomb friction of the second mass [N m] */
    double cogging_torque; /* amplitude [N m] */
    double cogging_periods; /* per turn [1] */
    double cogging_phase; /* [rad] */
    double i_saturation_d, i_saturation_q; /* current scale of the saturation of L_d, L_q [A] */
    double winding_warms; /* switch [1]; 1: r_s follows the winding's temperature at the ideal level too */
    double magnet_coefficient; /* temperature coefficient of the flux linkage, relative to ambient temperature [1/K] */
    double magnet_time; /* time constant of the magnet's temperature behind the winding's [s] */
    double disc_eccentricity; /* amplitude of the encoder's error, once per turn [rad] */
    double disc_phase; /* phase of that error [rad] */
    double load_torque; /* external, against positive motion; constant sign, unlike friction [N m] */
    double stop_min, stop_max; /* angles of the end stops [rad] (mechanical) */
    double stop_stiffness; /* [N m/rad]; 0: no end stops */
    double stop_damping; /* damping of the end stops [N m s] */
    double encoder_lines; /* lines per turn [1]; counts are four times as many */
    double theta_start; /* mechanical rotor angle at time zero [rad] */
    double i_full_scale; /* ADC range is -i_full_scale .. +i_full_scale [A] */
    double i_offset[3]; /* offset of each current amplifier [A] */
    double i_noise; /* standard deviation of a current sample [A] */
    double i_break; /* hardware over-current threshold [A] */
    double dead_time; /* dead time of the averaged plant [s] */
    double v_drop; /* forward drop of switch and diode [V] */
    double r_on; /* on resistance [ohm] */
    /* the next five: switching plant only */
    double dead_time_min; /* shortest dead time of the switches; with less, the leg is shorted for the difference [s] */
    double i_settle; /* time constant of the current amplifiers [s] */
    double encoder_jitter; /* standard deviation of an edge [counts] */
    double encoder_duty_error; /* a line is high for 1/2 + this of its period [1] */
    double encoder_hysteresis; /* distance between an edge passed forwards and backwards [counts] */
    double winding_capacity, winding_resistance; /* to the ambient air [J/K], [K/W] */
    double sink_capacity, sink_resistance; /* heatsink of the inverter [J/K], [K/W] */
    /* contacts and holding brake */
    double home_from, home_to; /* the home switch is closed between these mechanical angles [rad] */
    double limit_min, limit_max; /* the limit switches open at these mechanical angles [rad] */
    double enable_closed; /* switch [1]; 1: the enable circuit is closed, 0: open */
    double brake_torque; /* torque of the holding brake; 0: no brake [N m] */
    double brake_open_time, brake_close_time; /* delay behind its coil [s] */
} plant_axis_t;

typedef struct {
    double u_source; /* open-circuit supply voltage [V] */
    double r_source; /* source resistance [ohm]; the source takes no energy back */
    double capacitance; /* bus capacitance [F] */
    double u_full_scale; /* ADC full scale of the bus divider [V] */
    double u_noise; /* standard deviation of a bus sample [V] */
    double r_brake; /* brake resistor [ohm]; 0: none */
    double brake_capacity, brake_resistance; /* brake resistor, to the ambient air [J/K], [K/W] */
} plant_bus_t;

/* Speed of the core of the DSC (servo_twin/core.toml); register level only. */
typedef struct {
    double cycles_per_instruction; /* relative to a Cortex-M3 [1] */
    uint32_t entry_cycles; /* overhead of an interrupt: vector, registers saved and restored [cycles] */
} board_core_t;

/* Configuration of the firmware, raw numbers as in firmware/config/axis_config.h. */
typedef struct {
    const int32_t *member[2]; /* block of each axis, in the order of the members in axis_config.toml */
    int32_t fitted; /* bus_braking_config_t: a brake resistor is fitted [1] */
    int32_t on, off, heating, cooling, start, full, u_dc_max_braking; /* the rest of bus_braking_config_t */
    int32_t host_timeout, command_timeout; /* [slow ticks] */
    uint8_t password[3][20]; /* SHA-1 by level; zeros: no password */
} board_servo_config_t;

typedef struct {
    plant_axis_t axis[2];
    plant_bus_t bus;
    double pwm_frequency; /* [Hz] */
    double ambient; /* temperature of the air [deg C] */
    double baud; /* serial line [bit/s], 10 bits per byte */
    board_core_t core;
    uint64_t seed; /* seed of all random numbers */
    const uint8_t *flash; /* image of the data flash, board_flash_size() bytes; NULL: erased */
    const board_servo_config_t *servo; /* NULL: that of firmware/config/servo.toml */
    const uint8_t *elf; /* program that is executed instead of the linked firmware; register level only; NULL: none */
    size_t elf_size; /* [bytes] */
} board_config_t;

/* True state of the plant; reading it changes nothing. At register level that of the present clock, at the ideal level that of the
 * end of the last half cycle of the PWM. Temperatures are updated once in 1 ms. */
typedef struct {
    double theta_m; /* mechanical angle, not wrapped [rad] */
    double omega_m; /* mechanical speed [rad/s] */
    double i_d, i_q; /* [A]; with the ripple at register level */
    double torque_e; /* air-gap torque of these currents [N m] */
    double impulse_e; /* integral of the air-gap torque since power-on [N m s] */
    double t_sink; /* temperature of the axis' power stage [deg C] */
    double t_winding; /* temperature of the motor's winding [deg C] */
    double u_dc; /* bus voltage [V] */
    double e_brake; /* dissipated in the brake resistor since power-on [J] */
    double t_brake; /* temperature of the brake resistor [deg C] */
    /* Mean voltages of the motor's terminals against the midpoint of u_dc [V]: over the last half cycle at the ideal level,
     * over the last full window at register level (a PWM period; windows follow each other from power-on). */
    double u_a, u_b, u_c; /* [V] */
    double brake_holds; /* state [1]; 1: the holding brake is closed (and holds its torque), 0: open */
    double theta_load, omega_load; /* second mass, otherwise rotor [rad], [rad/s] */
    double torque_shaft; /* torque between rotor and second mass, mean of the present step [N m] */
    double t_magnet; /* temperature of the magnet [deg C] */
    double r_s, psi_m; /* values at these temperatures [ohm], [V s] */
    double l_d, l_q; /* differential inductances at these currents [H] */
} board_truth_t;

board_t *board_new(const board_config_t *config); /* NULL: out of memory */
void board_free(board_t *board);

/* Run up to and including simulated time `until_ns`; a time in the past does nothing. */
void board_advance(board_t *board, uint64_t until_ns);
uint64_t board_time_ns(const board_t *board);

/* Reason for which the board has stopped until another state is restored, otherwise NULL: the software used a function that is
 * not modelled, or a shaft is faster than any motor. */
const char *board_error(const board_t *board);

/* board_advance with a log of the signals of the chip, as of a logic analyser; stops early when `room` is full. Returns the
 * number of entries; 0 on a board without registers. */
size_t board_trace(board_t *board, uint64_t until_ns, trace_entry_t *log, size_t room);

/* Register access as by a debugger: a read has the side effects of a read, but does not complete a two-step flag-clear
 * sequence. Returns the value, or 0; -1: unknown register, which stops the board. */
int32_t board_peek(board_t *board, uint32_t address);
int board_poke(board_t *board, uint32_t address, uint16_t value);

/* board_advance with the snapshot block of each slow tick stored in `log` (rows of board_snapshot_size() bytes). Stops early
 * when `max_rows` are full. Returns the number of rows. */
size_t board_record(board_t *board, uint64_t until_ns, uint8_t *log, size_t max_rows);
size_t board_snapshot_size(void);

/* Serial line with the transmission time of the configured baud rate. */
size_t board_serial_in(board_t *board, const uint8_t *data,
                       size_t size); /* to the board; returns the number of accepted bytes */
size_t board_serial_out(board_t *board, uint8_t *data, size_t room); /* from the board: completely transmitted bytes */
uint64_t board_serial_next_ns(const board_t *board); /* time of the next byte on the line; UINT64_MAX: idle */

/* Access to firmware variables without the serial line, with the checks of FreeMASTER READMEM and WRITEMEM. 0 or a FreeMASTER
 * status code. */
uint8_t board_read(board_t *board, uint32_t address, uint8_t *data, uint16_t size);
uint8_t board_write(board_t *board, uint32_t address, const uint8_t *data, uint16_t size);

/* New parameters of the plant, except those fixed at construction (servo_twin/plant.py names them), the core, the seed and the
 * flash. Angles, speeds, currents and temperatures are kept. */
void board_change_plant(board_t *board, const board_config_t *config);

void board_truth(const board_t *board, int axis, board_truth_t *truth);
void board_set_load(board_t *board, int axis, double torque); /* external load torque, signed [N m] */
void board_set_supply(board_t *board, double volts); /* open-circuit supply voltage [V] */

/* The supply of the chip falls below its reset level for some time [s], that of the bus does not: registers and memory are lost, then
 * the software starts. NULL, or why this board cannot. */
const char *board_brown_out(board_t *board, double seconds);
void board_set_shaft(board_t *board, int axis, int locked); /* 1: shaft locked */
void board_obstruct_shaft(board_t *board, int axis, double below, double above); /* end stops, from here [rad] */

#define BOARD_SPEED_MAX 2000 /* of a driven shaft, whose encoder edges are queued [rad/s] */

/* Coupling with another simulator that owns the inertia of the shaft, its friction, load, end stops and cogging: all
 * of these have no effect in the board any more, and a lock or an obstruction of the shaft ends. Move the shaft from now on to angle
 * `theta` [rad] and speed `omega` [rad/s] in `seconds`, by a cubic; then it keeps this speed until the next call. The mean air-gap
 * torque of the step is the difference of impulse_e over its time. NULL, or why the motion is refused. */
const char *board_drive_shaft(board_t *board, int axis, double theta, double omega, double seconds);

/* Torque of the holding brake on a driven shaft, for the other simulator: it adds this to the air-gap torque in its next step of
 * `seconds`. Call it once per step at the end of the motion. `inertia` is that of all that the shaft moves there [kg m^2]. 0: the brake
 * is open, or there is none. */
double board_brake_torque(board_t *board, int axis, double inertia, double seconds);
void board_release_shaft(board_t *board, int axis); /* the board owns the shaft again, with its present motion */

void board_set_encoder(board_t *board, int axis, int connected); /* 0: both lines stuck low */
void board_cut_encoder(board_t *board, int axis,
                       int line); /* one line stuck low, 0: A, 1: B; board_set_encoder repairs */
void board_reverse_encoder(board_t *board, int axis); /* swap the lines A and B */
/* Set the temperature of a winding and the firmware's estimate of it [deg C]. FreeMASTER status: busy, and nothing is set, while a
 * program that is executed starts. */
uint8_t board_set_winding(board_t *board, int axis, double celsius);

/* Set the firmware's estimate alone [deg C]; the status is the same. */
uint8_t board_set_winding_estimate(board_t *board, int axis, double celsius);
void board_set_magnet(board_t *board, int axis, double celsius); /* temperature [deg C] */
void board_set_motor(board_t *board, int axis, int connected); /* 0: motor cable unplugged */

/* Wires of an axis. */
typedef enum {
    BOARD_PIN_HOME,
    BOARD_PIN_LIMIT_MIN,
    BOARD_PIN_LIMIT_MAX,
    BOARD_PIN_ENABLE,
    BOARD_PIN_BRAKE
} board_pin_t;

/* Pins that the firmware uses, a bit per board_pin_t; all of them if another program runs. */
unsigned board_pins(board_t *board, int axis);

/* Faults of the hardware. `part` is a phase (0, 1, 2) or an encoder line (0: A, 1: B). */
typedef enum {
    BOARD_OPEN_PHASE, /* part: the phase whose wire is broken */
    BOARD_SHORTED_PHASE, /* part: a phase; value: the other phase, or -1: bus minus. One short per axis */
    BOARD_STUCK_CONVERTER, /* part: the phase; value: the code that its converter gives */
    BOARD_STUCK_LINE, /* part: an encoder line; value: its level, 0 or 1 */
    BOARD_LOCKED_ROTOR,
    BOARD_SUPPLY_DIP, /* value: open-circuit voltage, 0: disconnected [V]; seconds: duration */
    BOARD_CURRENT_NOISE, /* value: standard deviation of a current sample [A] */
    BOARD_BUS_NOISE, /* value: standard deviation of a bus sample [V] */
    BOARD_ENCODER_GLITCHES, /* part: an encoder line; value: mean rate of random pulses [1/s] */
    BOARD_STALLED_CORE, /* seconds: the core executes nothing, unless the watchdog resets the board before */
    BOARD_HEAT, /* value: temperature at which the power stage is held [deg C] */
    BOARD_SLIPPED_ENCODER, /* value: counts by which the disc slips on the shaft; not undone when cleared */
    BOARD_CUT_WIRE /* part: a board_pin_t; a contact reads open, the brake's coil has no current */
} board_fault_kind_t;

typedef struct {
    int kind; /* board_fault_kind_t */
    int axis; /* 0 for faults of the bus */
    int part; /* see the kinds */
    double value; /* see the kinds [their unit] */
    double seconds; /* duration [s] */
} board_fault_t;

/* Inject a fault, or clear it; clearing one that is not present does nothing. */
void board_inject_fault(board_t *board, const board_fault_t *fault);
void board_clear_fault(board_t *board, const board_fault_t *fault);

/* Counters of the chip since reset. */
typedef struct {
    uint32_t serial_overruns; /* received bytes that the software did not fetch in time */
    uint32_t serial_lost; /* sent bytes that the host did not fetch in time */
    uint32_t breaks; /* times an over-current latch has tripped */
    uint32_t watchdog_services; /* services of the watchdog */
} board_stats_t;

void board_stats(const board_t *board, board_stats_t *stats);

/* Data flash (non-volatile). An image contains the words, low byte first, then the number of erases of each sector. */
size_t board_flash_size(void);
void board_flash_image(board_t *board, uint8_t *image);

typedef struct {
    uint32_t commands; /* commands begun since power-on */
    int busy; /* a command is in progress */
    int dead; /* power has failed */
} board_flash_state_t;

void board_flash_state(board_t *board, board_flash_state_t *state);

/* Power failure during a later command (`number` 1: the next one) after the fraction `part` (0..1) of its duration, or now. The
 * image is then frozen: it is the content that another board finds at power-on. */
void board_flash_cut(board_t *board, uint32_t number, double part);
void board_flash_cut_now(board_t *board);

/* Sample variables with a recorder of the firmware (0: every PWM period, 1: every slow tick), without a trigger, from the next
 * call of its loop on. `samples` is used until board_sample_end as a ring buffer of `points` points; a point contains the
 * variables in their order, without gaps. 0 or a FreeMASTER status code, then nothing is sampled. */
typedef struct {
    uint32_t address; /* address of the variable */
    uint8_t size; /* 1, 2, 4, 8 [bytes] */
} board_cell_t;

uint8_t board_sample(board_t *board, int recorder, const board_cell_t *cell, uint16_t cells, uint32_t *samples,
                     uint32_t points);
uint32_t board_sampled(board_t *board, uint32_t *next); /* number of valid points, index of the next point */
void board_sample_end(board_t *board);

/* Write the complete state of a board into `image`: firmware, chip, plant, random generators, flash, bytes on the line. At
 * register level the board first goes on to the end of the running handlers, less than a PWM period. *size becomes the size of the
 * image; it is written only if it fits into `room`. NULL, or why the board has no image now. */
const char *board_save(board_t *board, uint8_t *image, size_t room, size_t *size);

/* Continue from an image of the same build, of any board and process. NULL, or what is wrong with the image; then nothing has
 * changed. */
const char *board_restore(board_t *board, const uint8_t *image, size_t size);

/* The check sum that an image contains, of any bytes. */
uint64_t board_check_sum(const uint8_t *data, size_t size);

/* Address and size of the table of variables for board_read, in the format of FreeMASTER TSA (flags 13h). */
void board_table(uint32_t *address, uint32_t *size);
/* CFFI-END */

#endif
