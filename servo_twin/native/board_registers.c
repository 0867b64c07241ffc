/* The board with the MC56F84789 at register level and the plant at switching level. */
#include <stdlib.h>
#include <string.h>

#include "board_parts.h"
#include "chip/chip.h"
#include "config/contract_gen.h"
#include "plant/pins.h"
#include "plant/switching.h"
#include "port/mc56f84789/port.h"
#include "program.h"

#define CLOCK_NS 10u
#define SYNC_CLOCKS 2u /* through the crossbar; not documented, two flip-flops are assumed */

#define VECTOR_M1 85u    /* PWMA_CMP1 */
#define VECTOR_START 87u /* PWMA_CMP0: the sequence of both loops */

struct board {
    switching_t plant; /* at a multiple of SWITCHING_LINE */
    chip_t chip;
    servo_t servo;
    hal_t hal;
    servo_config_t config;
    double baud; /* of the serial line [bit/s] */
    uint64_t time_ns;  /* since `zero` [ns] */
    uint64_t zero;     /* clock at which the first period with loops begins: t0 of DRM F34 */
    bool booted;
    bool starting;   /* stop at the start of the sequence of both loops */
    uint32_t breaks; /* times an over-current comparator has tripped */
    uint32_t stall_clocks; /* added to the next control loop, as it would interrupt any other handler [bus clocks] */
    bool tripped[BOARD_AXES]; /* output of the over-current comparator */
    bool swapped[BOARD_AXES]; /* lines A and B of the encoder are swapped */
    plant_pins_t pins[BOARD_AXES];
    unsigned closed[BOARD_AXES]; /* contacts whose pins are low, a bit per board_pin_t */
    bool up;        /* the port has started the servo */
    bool recording; /* stop after each slow tick */
    uint32_t tick; /* of the last snapshot */
    program_t program; /* instead of servo and hal, if it is loaded */
};

#include "board_pointers.h"

#define LINE(member) offsetof(struct board, chip.sci.line.member)
#define LEFT_OUT(member) {.offset = offsetof(struct board, chip.member), .size = sizeof((struct board *)0)->chip.member}

/* The contexts and the stack belong to a process and an address; they are made anew. So does the decoded program. */
static const board_gap_t gaps[] = {
    LEFT_OUT(core.bus.escape),
    LEFT_OUT(core.inside),
    LEFT_OUT(core.outside),
    {LINE(in), SCI_LINE_IN, LINE(in_head), LINE(in_size)},
    {LINE(out), SCI_LINE_OUT, LINE(out_head), LINE(out_size)},
    LEFT_OUT(stack),
    {.offset = offsetof(struct board, program.arm.region),
     .size = offsetof(struct board, program.hooks) + sizeof(program_hooks_t *) -
             offsetof(struct board, program.arm.region)},
    {offsetof(struct board, program.ram), PROGRAM_RAM, offsetof(struct board, program.ram_first),
     offsetof(struct board, program.ram_used)},
};

const board_layout_t board_layout = {
    .size = sizeof(struct board),
    .pointer = board_pointers,
    .pointers = sizeof board_pointers / sizeof board_pointers[0],
    .gap = gaps,
    .gaps = sizeof gaps / sizeof gaps[0],
    .build = BOARD_BUILD,
};

/* ---- wiring -------------------------------------------------------------------------------------------------------- */

static const chip_wiring_t wiring = {
    .gate = {{{CHIP_PIN('E', 1), CHIP_PIN('E', 0)},
              {CHIP_PIN('E', 3), CHIP_PIN('E', 2)},
              {CHIP_PIN('E', 5), CHIP_PIN('E', 4)}},
             {{CHIP_PIN('G', 3), CHIP_PIN('G', 2)},
              {CHIP_PIN('G', 1), CHIP_PIN('G', 0)},
              {CHIP_PIN('E', 7), CHIP_PIN('E', 6)}}},
    .txd = CHIP_PIN('C', 7),
    .rxd = CHIP_PIN('C', 8),
};

static const unsigned encoder_pin[BOARD_AXES][2] = {{CHIP_PIN('C', 3), CHIP_PIN('C', 4)},
                                                    {CHIP_PIN('C', 2), CHIP_PIN('F', 8)}};
static const unsigned comparator_pin[BOARD_AXES] = {CHIP_PIN('E', 8), CHIP_PIN('F', 14)};
static const unsigned brake_resistor_pin = CHIP_PIN('G', 6);
#define CONTACTS 4 /* by board_pin_t; all to ground, pulled up */
static const unsigned contact_pin[BOARD_AXES][CONTACTS] = {
    {CHIP_PIN('F', 0), CHIP_PIN('F', 1), CHIP_PIN('F', 2), CHIP_PIN('E', 9)},
    {CHIP_PIN('F', 3), CHIP_PIN('F', 4), CHIP_PIN('F', 5), CHIP_PIN('F', 13)},
};
static const unsigned holding_pin[BOARD_AXES] = {CHIP_PIN('D', 5), CHIP_PIN('D', 6)};

/* Analogue pins ANA0-7, ANB0-7. Phase b is on both converters, so that any two phases can be sampled together. */
typedef enum { NOTHING, CURRENT, BUS, SINK } analog_kind_t;

static const struct {
    analog_kind_t kind;
    int axis, phase;
} analog[16] = {
    [0] = {CURRENT, 0, 0}, [1] = {CURRENT, 0, 1}, [8] = {CURRENT, 0, 1},  [9] = {CURRENT, 0, 2},
    [4] = {CURRENT, 1, 0}, [5] = {CURRENT, 1, 1}, [12] = {CURRENT, 1, 1}, [13] = {CURRENT, 1, 2},
    [6] = {BUS, 0, 0},     [14] = {SINK, 0, 0},   [15] = {SINK, 1, 0},
};

/* ---- environment of the chip ---------------------------------------------------------------------------------------- */

static void advance_plant(void *self, uint64_t clock)
{
    board_t *board = (board_t *)self;
    switching_advance(&board->plant, clock);
}

static uint64_t next_event(void *self)
{
    board_t *board = (board_t *)self;
    const switching_t *plant = &board->plant;
    return (plant->pending > 0) ? plant->now : switching_next(&board->plant); /* an edge may have shorted the bus */
}

/* The pin of an encoder's line, or that of the other line. */
static inline unsigned line_pin(const board_t *board, int axis, int line)
{
    return encoder_pin[axis][board->swapped[axis] ? 1 - line : line];
}

/* The plant defers edges that only count, which makes each one cheaper. */
static void deferrable_edges_changed(void *self)
{
    board_t *board = (board_t *)self;
    chip_plant_changed(&board->chip);
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        const unsigned a = chip_deferrable_edges(&board->chip, encoder_pin[axis][0]);
        const unsigned b = chip_deferrable_edges(&board->chip, encoder_pin[axis][1]);
        const unsigned edges = (a < b) ? a : b;
        if (edges != board->plant.axis[axis].deferrable_edges) {
            switching_defer_edges(&board->plant, axis, edges);
        }
    }
}

static void report_deferred(void *self)
{
    board_t *board = (board_t *)self;
    switching_event_t event;
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        while (switching_take_deferred(&board->plant, axis, &event)) {
            chip_pin_late(&board->chip, line_pin(board, axis, event.line), event.level, event.clock);
        }
    }
}

static void handle_events(void *self)
{
    board_t *board = (board_t *)self;
    switching_event_t event;
    report_deferred(self);
    while (switching_take(&board->plant, &event)) {
        if (event.kind == SWITCHING_ENCODER) {
            chip_pin(&board->chip, line_pin(board, event.axis, event.line), event.level);
        } else {
            chip_pin(&board->chip, comparator_pin[event.axis], event.level);
            board->breaks += (event.level && !board->tripped[event.axis]) ? 1u : 0u;
            board->tripped[event.axis] = event.level;
        }
    }
}

static void set_gates(void *self, unsigned module, unsigned submodule, unsigned levels)
{
    board_t *board = (board_t *)self;
    if (submodule >= 3u) {
        return; /* the monitor outputs drive no inverter */
    }
    chip_plant_changed(&board->chip);
    switching_edge(&board->plant, (int)module, (int)submodule, (switching_leg_t)levels);
}

static uint16_t convert(void *self, unsigned channel)
{
    board_t *board = (board_t *)self;
    switch (analog[channel].kind) {
    case CURRENT:
        return switching_current_code(&board->plant, analog[channel].axis, analog[channel].phase);
    case BUS:
        return switching_bus_code(&board->plant);
    case SINK:
        return plant_code_unipolar(board->plant.axis[analog[channel].axis].sink.t, PLANT_SINK_FULL_SCALE);
    default:
        return 0;
    }
}

static double seconds_of(const board_t *board) { return (double)board->chip.core.bus.now * (CLOCK_NS * 1e-9); }

static void show_contacts(board_t *board, int axis)
{
    const unsigned closed = plant_pins_closed(&board->pins[axis], switching_theta(&board->plant, axis));
    const unsigned changed = closed ^ board->closed[axis];
    board->closed[axis] = closed;
    for (unsigned pin = 0; changed != 0u && pin < CONTACTS; pin++) {
        if ((changed >> pin & 1u) != 0u) {
            chip_pin(&board->chip, contact_pin[axis][pin], (closed >> pin & 1u) == 0u);
        }
    }
}

/* Contacts and holding brakes are updated before each interrupt: they are much slower than that. */
static void update_pins(board_t *board)
{
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        plant_pins_t *pins = &board->pins[axis];
        if (plant_pins_follow(pins, seconds_of(board))) {
            switching_advance(&board->plant, board->chip.core.bus.now);
            switching_set_friction(&board->plant, axis, plant_pins_friction(pins));
            chip_plant_changed(&board->chip);
        }
        show_contacts(board, axis);
    }
}

/* The switch of the brake resistor and the coils of the holding brakes follow their pins. */
static void outputs_changed(void *self)
{
    board_t *board = (board_t *)self;
    chip_plant_changed(&board->chip);
    const bool on = chip_pin_level(&board->chip, brake_resistor_pin);
    if (on != board->plant.supply.braking) {
        switching_advance(&board->plant, board->chip.core.bus.now); /* from where the chip advanced it last */
        switching_brake_resistor(&board->plant, on);
    }
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        plant_pins_power(&board->pins[axis], chip_pin_level(&board->chip, holding_pin[axis]), seconds_of(board));
    }
}

static void boot(void *self)
{
    board_t *board = (board_t *)self;
    board->tick = 0;
    memset(&board->servo, 0, sizeof board->servo);
    memset(&board->hal, 0, sizeof board->hal);
    board->hal.chip = &board->chip;
    board->hal.baud = (uint32_t)(board->baud + 0.5); /* the same for both ends of the line */
    board->up = port_init(&board->hal, &board->servo, &board->config);
}

static void handler_begins(void *self) { update_pins((board_t *)self); }

/* Clocks by which the handler takes longer. */
static uint32_t handler_ended(board_t *board, unsigned vector, uint32_t tick)
{
    const bool second = vector == VECTOR_ADC_CC0;
    const bool loop = vector == VECTOR_M1 || second;
    const bool starts = board->starting && vector == VECTOR_START;
    const bool published = second && tick != board->tick;
    board->tick = second ? tick : board->tick; /* another handler may end in it, after the snapshot */
    board->starting = board->starting && !starts;
    board->chip.core.stop = board->chip.core.stop || starts || (board->recording && published);
    const uint32_t stall = loop ? board->stall_clocks : 0u;
    board->stall_clocks -= stall;
    return stall;
}

static uint32_t interrupt(void *self, unsigned vector)
{
    board_t *board = (board_t *)self;
    handler_begins(self);
    port_isr(&board->hal, (uint16_t)vector);
    return handler_ended(board, vector, board->servo.snapshot.tick);
}

static uint32_t handler_ends(void *self, unsigned vector)
{
    board_t *board = (board_t *)self;
    return handler_ended(board, vector, program_tick(&board->program));
}

static const program_hooks_t hooks = {handler_begins, handler_ends};

static void background(void *self)
{
    board_t *board = (board_t *)self;
    if (board->up) {
        servo_background(&board->servo);
    }
}

static const chip_environment_t environment = {
    .advance = advance_plant,
    .next_event = next_event,
    .handle_events = handle_events,
    .deferrable_edges_changed = deferrable_edges_changed,
    .report_deferred = report_deferred,
    .set_gates = set_gates,
    .outputs_changed = outputs_changed,
    .convert = convert,
    .boot = boot,
    .interrupt = interrupt,
    .background = background,
};

flash_t *board_flash(board_t *board, uint64_t *now_ns)
{
    *now_ns = board->chip.core.bus.now * CLOCK_NS;
    return &board->chip.ftfl.flash;
}

/* ---- board.h -------------------------------------------------------------------------------------------------------- */

/* The memory that holds a board; kept in front of it. */
static void **allocated(board_t *board) { return (void **)(void *)board - 1; }

static void refuse_program(board_t *board, const char *problem)
{
    bus_t *bus = &board->chip.core.bus;
    if (problem != NULL && setjmp(bus->escape) == 0) {
        bus_fail(bus, "%s", problem);
    }
}

board_t *board_new(const board_config_t *config)
{
    uint8_t *room = (uint8_t *)calloc(1, sizeof(board_t) + 2 * SWITCHING_LINE);
    if (room == NULL) {
        return NULL;
    }
    board_t *board = (board_t *)(void *)(room + 2 * SWITCHING_LINE - (uintptr_t)room % SWITCHING_LINE);
    *allocated(board) = room;
    board->baud = config->baud;
    board_servo_config(config, &board->config);
    switching_init(&board->plant, config);
    const chip_config_t chip = {
        .wiring = wiring,
        .baud = config->baud,
        .crossbar_clocks = SYNC_CLOCKS,
        .flash = config->flash,
        .seed = config->seed,
        .core = {config->core.cycles_per_instruction, config->core.entry_cycles},
    };
    chip_init(&board->chip, &chip, &environment, board);
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        for (int line = 0; line < 2; line++) {
            chip_pin(&board->chip, encoder_pin[axis][line], switching_line(&board->plant, axis, line));
        }
        plant_pins_init(&board->pins[axis], &config->axis[axis]);
        switching_set_friction(&board->plant, axis, plant_pins_friction(&board->pins[axis]));
        board->closed[axis] = ~0u; /* the pins are low so far */
        show_contacts(board, axis);
    }
    if (config->elf != NULL) {
        board->program.timeless = board->chip.core.unit_clocks == 0u;
        refuse_program(board,
                       program_load(&board->program, &board->chip, &hooks, config->elf, config->elf_size,
                                    (config->servo != NULL) ? &board->config : NULL, (uint32_t)(board->baud + 0.5)));
    }
    return board;
}

#define START_MAX 100000u /* clocks within which the sequence starts after the boot */
#define BOOT_MAX 2000000u /* of a program, with the boot */

static void run_chip(board_t *board, uint64_t until)
{
    if (board->program.loaded) {
        program_run(&board->program, until);
    } else {
        (void)chip_run(&board->chip, until);
    }
}

/* The software boots in the first access to the board, so that a trace can begin at power-on. Time zero of the interface is
 * the low-side centre of motor 1 in the first period with both loops: as on the board with the ideal chip. */
static void boot_once(board_t *board)
{
    if (board->booted) {
        return;
    }
    board->booted = true;
    board->starting = board->program.loaded;
    run_chip(board, board->program.loaded ? BOOT_MAX : 0u);
    if (!board->program.loaded) {
        board->starting = true;
        run_chip(board, board->chip.core.bus.now + START_MAX);
    } else if (!board->starting && program_contract(&board->program) != CATALOGUE_HASH) {
        refuse_program(board, "the ELF file has another table of variables (variables.toml) than this version");
    }
    board->zero = board->chip.core.bus.now;
    if (!board->starting) {
        const pwm_submodule_t *master = &board->chip.pwm.module[0].sub[0];
        board->zero = master->origin + master->distance[PWM_CYCLE];
        board->chip.core.stop = false;
        run_chip(board, board->zero - 1u);
    }
    board->starting = false;
}

void board_free(board_t *board)
{
    if (board != NULL) {
        program_free(&board->program);
        free(*allocated(board));
    }
}

servo_t *board_servo(board_t *board)
{
    boot_once(board);
    return &board->servo;
}

uint64_t board_program_identity(const board_t *board) { return board->program.identity; }

uint8_t board_software_read(board_t *board, uint32_t address, uint8_t *data, uint16_t size)
{
    boot_once(board);
    return board->program.loaded ? program_read(&board->program, address, data, size)
                                 : servo_read(&board->servo, address, data, size);
}

uint8_t board_software_write(board_t *board, uint32_t address, const uint8_t *data, uint16_t size)
{
    boot_once(board);
    return board->program.loaded ? program_write(&board->program, address, data, size)
                                 : servo_write(&board->servo, address, data, size);
}

const void *board_software_snapshot(board_t *board)
{
    return board->program.loaded ? (const void *)program_snapshot(&board->program)
                                 : (const void *)&board->servo.snapshot;
}

void board_software_set_winding(board_t *board, int axis, frac32_t temperature)
{
    boot_once(board);
    if (board->program.loaded) {
        program_set_winding(&board->program, axis, temperature);
    } else {
        board->servo.axis[axis].diagnosis.winding.temperature = temperature;
    }
}

const char *board_error(const board_t *board)
{
    return board->chip.core.bus.failed ? board->chip.core.bus.error : NULL;
}

/* Returns true if it has stopped before `until_ns`, for a slow tick. */
static bool run(board_t *board, uint64_t until_ns)
{
    boot_once(board);
    board->chip.core.stop = false;
    run_chip(board, board->zero + until_ns / CLOCK_NS);
    const uint64_t reached =
        (board->chip.core.bus.now > board->zero) ? (board->chip.core.bus.now - board->zero) * CLOCK_NS : 0u;
    if (board->chip.core.stop || board->chip.core.bus.failed) {
        board->time_ns = (reached > board->time_ns) ? reached : board->time_ns;
        return board->chip.core.stop;
    }
    board->time_ns = (until_ns > board->time_ns) ? until_ns : board->time_ns;
    board->time_ns = (reached > board->time_ns) ? reached : board->time_ns;
    return false;
}

void board_advance(board_t *board, uint64_t until_ns) { (void)run(board, until_ns); }

#define REST_NS UINT64_C(1000000) /* the handlers of sixteen PWM periods have no end: the core is overloaded */

const char *board_rest(board_t *board)
{
    boot_once(board);
    if (board->program.loaded) {
        return NULL; /* at any time */
    }
    board->chip.core.stop_resting = true;
    (void)run(board, board->chip.core.resting ? board->time_ns : board->time_ns + REST_NS);
    board->chip.core.stop_resting = false;
    return (board->chip.core.resting || board->chip.core.bus.failed) ? NULL
                                                                     : "the software has not come to rest within 1 ms";
}

void board_restored(board_t *board)
{
    board->chip.core.alive = false;
    board->program.arm.failed = false;
}

uint64_t board_time_ns(const board_t *board) { return board->time_ns; }

bool board_run_to_tick(board_t *board, uint64_t until_ns)
{
    board->recording = true;
    const bool published = run(board, until_ns);
    board->recording = false;
    return published;
}

size_t board_trace(board_t *board, uint64_t until_ns, trace_entry_t *log, size_t room)
{
    board->chip.core.bus.trace = (trace_t){.entry = log, .size = 0, .remaining = room};
    board_advance(board, until_ns);
    const size_t size = board->chip.core.bus.trace.size;
    board->chip.core.bus.trace = (trace_t){.entry = NULL, .size = 0, .remaining = 0};
    return size;
}

int32_t board_peek(board_t *board, uint32_t address)
{
    boot_once(board);
    return chip_peek(&board->chip, address);
}

int board_poke(board_t *board, uint32_t address, uint16_t value)
{
    boot_once(board);
    return chip_poke(&board->chip, address, value);
}

size_t board_serial_in(board_t *board, const uint8_t *data, size_t size)
{
    boot_once(board);
    return sci_line_write(&board->chip.sci, data, size);
}

size_t board_serial_out(board_t *board, uint8_t *data, size_t room)
{
    return sci_line_read(&board->chip.sci, data, room);
}

uint64_t board_serial_next_ns(const board_t *board)
{
    const uint64_t clock = sci_line_next(&board->chip.sci);
    return (clock == CHIP_NEVER) ? UINT64_MAX : (clock > board->zero) ? (clock - board->zero) * CLOCK_NS : 0u;
}

void board_truth(const board_t *board, int axis, board_truth_t *truth)
{
    switching_truth_t now;
    switching_bus_t bus;
    switching_truth(&board->plant, axis, &now);
    switching_bus(&board->plant, &bus);
    const double middle = 0.5 * bus.u_dc;
    *truth = (board_truth_t){
        .theta_m = now.theta,
        .omega_m = now.omega,
        .i_d = now.i_d,
        .i_q = now.i_q,
        .torque_e = now.torque,
        .impulse_e = now.impulse,
        .u_a = now.voltage[0] - middle,
        .u_b = now.voltage[1] - middle,
        .u_c = now.voltage[2] - middle,
        .t_sink = now.t_sink,
        .t_winding = now.t_winding,
        .u_dc = bus.u_dc,
        .e_brake = bus.e_brake,
        .t_brake = bus.t_brake,
        .theta_load = now.theta_load,
        .omega_load = now.omega_load,
        .torque_shaft = now.torque_shaft,
        .t_magnet = now.t_magnet,
        .r_s = now.r_s,
        .psi_m = now.psi_m,
        .l_d = now.l_d,
        .l_q = now.l_q,
        .brake_holds = board->pins[axis].holds ? 1.0 : 0.0,
    };
}

void board_stats(const board_t *board, board_stats_t *stats)
{
    *stats = (board_stats_t){
        .serial_overruns = board->chip.sci.line.overruns,
        .serial_lost = board->chip.sci.line.lost,
        .breaks = board->breaks,
        .watchdog_services = board->chip.cop.services,
    };
}

void board_change_plant(board_t *board, const board_config_t *config)
{
    boot_once(board);
    switching_change(&board->plant, config);
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        plant_pins_change(&board->pins[axis], &config->axis[axis]);
        switching_set_friction(&board->plant, axis, plant_pins_friction(&board->pins[axis]));
        show_contacts(board, axis);
    }
    chip_plant_changed(&board->chip);
}

void board_set_load(board_t *board, int axis, double torque) { switching_set_load(&board->plant, axis, torque); }

void board_set_supply(board_t *board, double volts) { switching_set_supply(&board->plant, volts); }

void board_set_shaft(board_t *board, int axis, int locked) { switching_lock(&board->plant, axis, locked != 0); }

void board_set_encoder(board_t *board, int axis, int connected)
{
    switching_cut(&board->plant, axis, 0, connected == 0, false);
    switching_cut(&board->plant, axis, 1, connected == 0, false);
}

void board_cut_encoder(board_t *board, int axis, int line) { switching_cut(&board->plant, axis, line, true, false); }

void board_reverse_encoder(board_t *board, int axis)
{
    board->swapped[axis] = !board->swapped[axis];
    for (int line = 0; line < 2; line++) {
        chip_pin(&board->chip, line_pin(board, axis, line), switching_line(&board->plant, axis, line));
    }
    deferrable_edges_changed(board); /* these edges were counted, too */
}

void board_obstruct_shaft(board_t *board, int axis, double below, double above)
{
    switching_obstruct(&board->plant, axis, below, above);
}

void board_drive_rotor(board_t *board, int axis, double theta, double omega, double seconds)
{
    boot_once(board);
    switching_advance(&board->plant, board->chip.core.bus.now);
    switching_drive_shaft(&board->plant, axis, theta, omega, seconds);
    chip_plant_changed(&board->chip);
}

void board_release_shaft(board_t *board, int axis)
{
    switching_advance(&board->plant, board->chip.core.bus.now);
    switching_release_shaft(&board->plant, axis);
    chip_plant_changed(&board->chip);
}

bool board_has_second_mass(const board_t *board, int axis) { return board->plant.shaft[axis].two_masses; }

void board_warm_winding(board_t *board, int axis, double celsius)
{
    switching_warm_winding(&board->plant, axis, celsius);
}

void board_set_magnet(board_t *board, int axis, double celsius) { switching_warm_magnet(&board->plant, axis, celsius); }

void board_set_motor(board_t *board, int axis, int connected) { switching_plug(&board->plant, axis, connected != 0); }

void board_cut_wire(board_t *board, int axis, int pin, bool cut)
{
    plant_pins_cut(&board->pins[axis], pin, cut, seconds_of(board));
    show_contacts(board, axis);
}

void board_stall_core(board_t *board, double seconds) { board->stall_clocks = (uint32_t)(seconds * 1e9 / CLOCK_NS); }

void board_set_plant_fault(board_t *board, const board_fault_t *fault, bool cleared)
{
    switching_set_fault(&board->plant, fault, cleared);
}
