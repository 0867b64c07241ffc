/* The board at register level: the plant at switching level, a chip, and its software. */
#include "board_registers.h"

#include <stdlib.h>
#include <string.h>

#include "comm/status.h"
#include "config/contract_gen.h"

#include "board_pointers.h"

#define LINE(member) offsetof(struct board, chip.BOARD_LINE.member)
#define LEFT_OUT(member) {.offset = offsetof(struct board, chip.member), .size = sizeof((struct board *)0)->chip.member}

/* The contexts and the stack belong to a process and an address; they are made anew. So does the decoded program. */
static const board_gap_t gaps[] = {
    LEFT_OUT(BOARD_BUS.escape),
    BOARD_GAPS_BEFORE_LINE{LINE(in), SERIAL_LINE_IN, LINE(in_head), LINE(in_size)},
    {LINE(out), SERIAL_LINE_OUT, LINE(out_head), LINE(out_size)},
    BOARD_GAPS_BEHIND_LINE{.offset = offsetof(struct board, sampler), .size = sizeof(board_sampler_t)},
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

/* ---- environment of the chip ---------------------------------------------------------------------------------------- */

static void advance_plant(void *self, uint64_t clock)
{
    board_t *board = (board_t *)self;
    switching_advance(&board->plant, clock);
    if (board->plant.too_fast) {
        board->chip.BOARD_BUS.stop = true;
    }
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
    return board_wiring.encoder[axis][board->swapped[axis] ? 1 - line : line];
}

/* The plant defers edges that only count, which makes each one cheaper. */
static void deferrable_edges_changed(void *self)
{
    board_t *board = (board_t *)self;
    chip_plant_changed(&board->chip);
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        const unsigned a = chip_deferrable_edges(&board->chip, board_wiring.encoder[axis][0]);
        const unsigned b = chip_deferrable_edges(&board->chip, board_wiring.encoder[axis][1]);
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
            board_over_current(board, event.axis, event.level);
            board->breaks += (event.level && !board->tripped[event.axis]) ? 1u : 0u;
            board->tripped[event.axis] = event.level;
        }
    }
}

static double seconds_of(const board_t *board)
{
    return (double)board->chip.BOARD_BUS.now * (1000.0 / BOARD_CLOCK_MHZ * 1e-9);
}

static void show_contacts(board_t *board, int axis)
{
    const unsigned closed = plant_pins_closed(&board->pins[axis], switching_theta(&board->plant, axis));
    const unsigned changed = closed ^ board->closed[axis];
    board->closed[axis] = closed;
    for (unsigned pin = 0; changed != 0u && pin < BOARD_CONTACTS; pin++) {
        if ((changed >> pin & 1u) != 0u && board_wiring.contact[axis][pin] != BOARD_NO_PIN) {
            chip_pin(&board->chip, board_wiring.contact[axis][pin], (closed >> pin & 1u) == 0u);
        }
    }
}

/* Contacts and holding brakes are updated before each interrupt: they are much slower than that. */
static void update_pins(board_t *board)
{
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        plant_pins_t *pins = &board->pins[axis];
        if (plant_pins_follow(pins, seconds_of(board))) {
            switching_advance(&board->plant, board->chip.BOARD_BUS.now);
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
    const bool on = chip_pin_level(&board->chip, board_wiring.brake_resistor);
    if (on != board->plant.supply.braking) {
        switching_advance(&board->plant, board->chip.BOARD_BUS.now); /* from where the chip advanced it last */
        switching_brake_resistor(&board->plant, on);
    }
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        const unsigned coil = board_wiring.holding[axis];
        plant_pins_power(&board->pins[axis], chip_pin_level(&board->chip, coil), seconds_of(board));
    }
}

static void boot(void *self)
{
    board_t *board = (board_t *)self;
    board->tick = 0;
    board_boot(board);
}

static void program_starts(void *self) { ((board_t *)self)->tick = 0; }

static void handler_begins(void *self) { update_pins((board_t *)self); }

/* Clocks by which the handler takes longer. */
static uint32_t handler_ended(board_t *board, unsigned vector, uint32_t tick)
{
    const bool second = vector == board_wiring.vector_m2;
    const bool loop = vector == board_wiring.vector_m1 || second;
    const bool starts = board->starting && vector == board_wiring.vector_start;
    const bool published = second && tick != board->tick;
    if (published) {
        board_sampler_take(&board->sampler, 1);
    }
    if (second) {
        board_sampler_take(&board->sampler, 0);
    }
    board->tick = second ? tick : board->tick; /* another handler may end in it, after the snapshot */
    board->starting = board->starting && !starts;
    board->chip.BOARD_BUS.stop = board->chip.BOARD_BUS.stop || starts || (board->recording && published);
    const uint32_t stall = loop ? board->stall_clocks : 0u;
    board->stall_clocks -= stall;
    return stall;
}

static uint32_t interrupt(void *self, unsigned vector)
{
    board_t *board = (board_t *)self;
    handler_begins(self);
    board_interrupt(board, vector);
    return handler_ended(board, vector, board->linked.servo.snapshot.tick);
}

static uint32_t handler_ends(void *self, unsigned vector)
{
    board_t *board = (board_t *)self;
    return handler_ended(board, vector, program_tick(&board->program));
}

static const program_hooks_t hooks = {program_starts, handler_begins, handler_ends};

static void background(void *self) { board_background((board_t *)self); }

static const chip_environment_t environment = {
    .advance = advance_plant,
    .next_event = next_event,
    .handle_events = handle_events,
    .deferrable_edges_changed = deferrable_edges_changed,
    .report_deferred = report_deferred,
    .set_gates = board_set_gates,
    .outputs_changed = outputs_changed,
    .convert = board_convert,
    .boot = boot,
    .interrupt = interrupt,
    .background = background,
};

flash_t *board_flash(board_t *board, uint64_t *now_ns)
{
    *now_ns = board_clocks_ns(board->chip.BOARD_BUS.now);
    return &board->chip.BOARD_FLASH;
}

/* ---- board.h -------------------------------------------------------------------------------------------------------- */

/* The memory that holds a board; kept in front of it. */
static void **allocated(board_t *board) { return (void **)(void *)board - 1; }

static void refuse_program(board_t *board, const char *problem)
{
    bus_t *bus = &board->chip.BOARD_BUS;
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
    board_chip_init(board, config, &environment);
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        for (int line = 0; line < 2; line++) {
            chip_pin(&board->chip, board_wiring.encoder[axis][line], switching_line(&board->plant, axis, line));
        }
        plant_pins_init(&board->pins[axis], &config->axis[axis]);
        switching_set_friction(&board->plant, axis, plant_pins_friction(&board->pins[axis]));
        board->closed[axis] =
            ~plant_pins_closed(&board->pins[axis], switching_theta(&board->plant, axis)); /* show all */
        show_contacts(board, axis);
    }
    if (config->elf != NULL) {
        board->program.timeless = board_timeless(board);
        refuse_program(board,
                       program_load(&board->program, &board_program_chip, &board->chip, &board->chip.BOARD_BUS, &hooks,
                                    config->elf, config->elf_size, (config->servo != NULL) ? &board->config : NULL,
                                    (uint32_t)(board->baud + 0.5)));
        board_program_loaded(board);
    }
    return board;
}

#define START_MAX 100000u /* clocks within which the sequence starts after the boot */

static void run_chip(board_t *board, uint64_t until)
{
    if (board->program.loaded) {
        program_run(&board->program, until);
    } else {
        board_run_linked(board, until);
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
    run_chip(board, board->program.loaded ? board_wiring.boot_clocks : 0u);
    if (!board->program.loaded) {
        board->starting = true;
        run_chip(board, board->chip.BOARD_BUS.now + START_MAX);
    } else if (!board->starting && program_contract(&board->program) != CATALOGUE_HASH) {
        refuse_program(board, "the ELF file has another table of variables (variables.toml) than this version");
    }
    board->zero = board->chip.BOARD_BUS.now;
    if (!board->starting) {
        board->zero = board_time_zero(board);
        board->chip.BOARD_BUS.stop = false;
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
    return &board->linked.servo;
}

board_sampler_t *board_sampler(board_t *board)
{
    boot_once(board);
    return board->program.loaded ? &board->sampler : NULL;
}

uint8_t board_program_place(board_t *board, uint32_t address, uint16_t size, const uint8_t **place)
{
    return program_live(&board->program, address, size, place);
}

uint64_t board_program_identity(const board_t *board) { return board->program.identity; }

uint8_t board_software_read(board_t *board, uint32_t address, uint8_t *data, uint16_t size)
{
    boot_once(board);
    return board->program.loaded ? program_read(&board->program, address, data, size)
                                 : servo_read(&board->linked.servo, address, data, size);
}

uint8_t board_software_write(board_t *board, uint32_t address, const uint8_t *data, uint16_t size)
{
    boot_once(board);
    return board->program.loaded ? program_write(&board->program, address, data, size)
                                 : servo_write(&board->linked.servo, address, data, size);
}

const void *board_software_snapshot(board_t *board)
{
    return board->program.loaded ? (const void *)program_snapshot(&board->program)
                                 : (const void *)&board->linked.servo.snapshot;
}

uint8_t board_software_set_winding(board_t *board, int axis, frac32_t temperature)
{
    boot_once(board);
    if (board->program.loaded) {
        return program_set_winding(&board->program, axis, temperature);
    }
    board->linked.servo.axis[axis].diagnosis.winding.temperature = temperature;
    return FM_OK;
}

const char *board_error(const board_t *board)
{
    return board->chip.BOARD_BUS.failed ? board->chip.BOARD_BUS.error : board->plant.too_fast ? SHAFT_TOO_FAST : NULL;
}

/* Returns true if it has stopped before `until_ns`, for a slow tick. */
static bool run(board_t *board, uint64_t until_ns)
{
    boot_once(board);
    if (board->plant.too_fast) {
        return false;
    }
    board->chip.BOARD_BUS.stop = false;
    run_chip(board, board->zero + board_clocks(until_ns));
    const uint64_t reached =
        (board->chip.BOARD_BUS.now > board->zero) ? board_clocks_ns(board->chip.BOARD_BUS.now - board->zero) : 0u;
    if (board->chip.BOARD_BUS.stop || board->chip.BOARD_BUS.failed) {
        board->time_ns = (reached > board->time_ns) ? reached : board->time_ns;
        return board->chip.BOARD_BUS.stop && !board->plant.too_fast;
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
    bool *resting = board_stop_resting(board, true);
    (void)run(board, *resting ? board->time_ns : board->time_ns + REST_NS);
    (void)board_stop_resting(board, false);
    return (*resting || board->chip.BOARD_BUS.failed) ? NULL : "the software has not come to rest within 1 ms";
}

void board_restored(board_t *board)
{
    board_restored_linked(board);
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
    board->chip.BOARD_BUS.trace = (trace_t){.entry = log, .size = 0, .remaining = room};
    board_advance(board, until_ns);
    const size_t size = board->chip.BOARD_BUS.trace.size;
    board->chip.BOARD_BUS.trace = (trace_t){.entry = NULL, .size = 0, .remaining = 0};
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
    return chip_line_write(&board->chip, data, size);
}

size_t board_serial_out(board_t *board, uint8_t *data, size_t room)
{
    return serial_line_read(&board->chip.BOARD_LINE, data, room);
}

uint64_t board_serial_next_ns(const board_t *board)
{
    const uint64_t clock = chip_line_next(&board->chip);
    return (clock == CHIP_NEVER) ? UINT64_MAX : (clock > board->zero) ? board_clocks_ns(clock - board->zero) : 0u;
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
        .serial_overruns = board->chip.BOARD_LINE.overruns,
        .serial_lost = board->chip.BOARD_LINE.lost,
        .breaks = board->breaks,
        .watchdog_services = board->chip.BOARD_WATCHDOG.services,
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
    switching_advance(&board->plant, board->chip.BOARD_BUS.now);
    switching_drive_shaft(&board->plant, axis, theta, omega, seconds);
    chip_plant_changed(&board->chip);
}

void board_release_shaft(board_t *board, int axis)
{
    switching_advance(&board->plant, board->chip.BOARD_BUS.now);
    switching_release_shaft(&board->plant, axis);
    chip_plant_changed(&board->chip);
}

bool board_has_second_mass(const board_t *board, int axis) { return board->plant.shaft[axis].two_masses; }

driven_shaft_t *board_driven_shaft(board_t *board, int axis) { return &board->plant.axis[axis].driven; }

const plant_pins_t *board_plant_pins(const board_t *board, int axis) { return &board->pins[axis]; }

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

void board_stall_core(board_t *board, double seconds)
{
    board->stall_clocks = (uint32_t)(seconds * 1e9 * BOARD_CLOCK_MHZ / 1000.0);
}

const char *board_brown_out(board_t *board, double seconds)
{
    boot_once(board);
    if (!program_brown_out(&board->program, board_clocks((uint64_t)(seconds * 1e9)))) {
        return BOARD_NO_BROWN_OUT;
    }
    board->stall_clocks = 0;
    chip_plant_changed(&board->chip);
    return NULL;
}

void board_set_plant_fault(board_t *board, const board_fault_t *fault, bool cleared)
{
    switching_set_fault(&board->plant, fault, cleared);
}
