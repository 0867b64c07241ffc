/* The circuits around the MC56F84789, and the software that is linked with it. */
#include "board_registers.h"

#include <string.h>

#define SYNC_CLOCKS 2u /* through the crossbar; not documented, two flip-flops are assumed */

#define VECTOR_M1 85u    /* PWMA_CMP1 */
#define VECTOR_START 87u /* PWMA_CMP0: the sequence of both loops */

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

const board_wiring_t board_wiring = {
    .encoder = {{CHIP_PIN('C', 3), CHIP_PIN('C', 4)}, {CHIP_PIN('C', 2), CHIP_PIN('F', 8)}},
    .contact = {{CHIP_PIN('F', 0), CHIP_PIN('F', 1), CHIP_PIN('F', 2), CHIP_PIN('E', 9)},
                {CHIP_PIN('F', 3), CHIP_PIN('F', 4), CHIP_PIN('F', 5), CHIP_PIN('F', 13)}},
    .brake_resistor = CHIP_PIN('G', 6),
    .holding = {CHIP_PIN('D', 5), CHIP_PIN('D', 6)},
    .vector_m1 = VECTOR_M1,
    .vector_m2 = VECTOR_ADC_CC0,
    .vector_start = VECTOR_START,
    .boot_clocks = 2000000u,
};

static const unsigned comparator_pin[BOARD_AXES] = {CHIP_PIN('E', 8), CHIP_PIN('F', 14)};

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

void board_set_gates(void *self, unsigned module, unsigned submodule, unsigned levels)
{
    board_t *board = (board_t *)self;
    if (submodule >= 3u) {
        return; /* the monitor outputs drive no inverter */
    }
    chip_plant_changed(&board->chip);
    switching_edge(&board->plant, (int)module, (int)submodule, (switching_leg_t)levels);
}

uint16_t board_convert(void *self, unsigned channel)
{
    board_t *board = (board_t *)self;
    switch (analog[channel].kind) {
    case CURRENT:
        return switching_current_code(&board->plant, analog[channel].axis, analog[channel].phase);
    case BUS:
        return switching_bus_code(&board->plant);
    case SINK:
        return plant_code_sink(board->plant.axis[analog[channel].axis].sink.t);
    default:
        return 0;
    }
}

void board_over_current(board_t *board, int axis, bool tripped)
{
    chip_pin(&board->chip, comparator_pin[axis], tripped);
}

/* ---- software ------------------------------------------------------------------------------------------------------- */

void board_boot(board_t *board)
{
    board_software_t *linked = &board->linked;
    memset(&linked->servo, 0, sizeof linked->servo);
    memset(&linked->hal, 0, sizeof linked->hal);
    linked->hal.chip = &board->chip;
    linked->hal.baud = (uint32_t)(board->baud + 0.5); /* the same for both ends of the line */
    linked->up = port_init(&linked->hal, &linked->servo, &board->config);
}

void board_interrupt(board_t *board, unsigned vector) { port_isr(&board->linked.hal, (uint16_t)vector); }

void board_background(board_t *board)
{
    if (board->linked.up) {
        servo_background(&board->linked.servo);
    }
}

void board_run_linked(board_t *board, uint64_t until) { (void)chip_run(&board->chip, until); }

bool board_timeless(const board_t *board) { return board->chip.core.unit_clocks == 0u; }

bool *board_stop_resting(board_t *board, bool on)
{
    board->chip.core.stop_resting = on;
    return &board->chip.core.resting;
}

void board_restored_linked(board_t *board) { board->chip.core.alive = false; }

/* ---- for a program -------------------------------------------------------------------------------------------------- */

#define PERIPHERALS 0x40000000u
#define PERIPHERALS_SIZE 0x20000u /* 64 k words */

static bool is_register(uint32_t address, unsigned size)
{
    return address - PERIPHERALS < PERIPHERALS_SIZE && size == sizeof(uint16_t);
}

static bool read_register(void *chip, uint32_t address, unsigned size, uint32_t *value)
{
    const bool found = is_register(address, size);
    if (found) {
        *value = chip_read((chip_t *)chip, (address - PERIPHERALS) / 2u);
    }
    return found;
}

static bool write_register(void *chip, uint32_t address, unsigned size, uint32_t value)
{
    const bool found = is_register(address, size);
    if (found) {
        chip_write((chip_t *)chip, (address - PERIPHERALS) / 2u, (uint16_t)value);
    }
    return found;
}

static void catch_up(void *chip) { qtmr_catch_up(&((chip_t *)chip)->qtmr); }

const program_chip_t board_program_chip = {
    .port = "mc56f84789_m4",
    .flash = {0u, 0x40000u},
    .ram = {{0x20000000u, 0x8000u}},
    .read = read_register,
    .write = write_register,
    .catch_up = catch_up,
};

/* ---- life ----------------------------------------------------------------------------------------------------------- */

void board_chip_init(board_t *board, const board_config_t *config, const chip_environment_t *environment)
{
    const chip_config_t chip = {
        .wiring = wiring,
        .baud = config->baud,
        .crossbar_clocks = SYNC_CLOCKS,
        .flash = config->flash,
        .seed = config->seed,
        .core = {config->core.cycles_per_instruction, config->core.entry_cycles},
    };
    chip_init(&board->chip, &chip, environment, board);
}

void board_program_loaded(board_t *board) { (void)board; }

uint64_t board_time_zero(const board_t *board)
{
    const pwm_submodule_t *master = &board->chip.pwm.module[0].sub[0];
    return master->origin + master->distance[PWM_CYCLE];
}
