/* The circuits of the board ODrive v3.6 around its STM32F405. */
#include "board_registers.h"
#include "port/stm32f405/registers.h"

#define FULL_GAIN 80u /* of the current amplifiers, to which the plant's i_full_scale belongs */
#define MIDDLE 2048

const board_wiring_t board_wiring = {
    .encoder = {{SOC_PIN('B', 4), SOC_PIN('B', 5)}, {SOC_PIN('B', 6), SOC_PIN('B', 7)}},
    .contact = {{SOC_PIN('C', 9), BOARD_NO_PIN, BOARD_NO_PIN, SOC_PIN('A', 0)},
                {SOC_PIN('C', 15), BOARD_NO_PIN, BOARD_NO_PIN, SOC_PIN('A', 1)}},
    .brake_resistor = SOC_PIN('B', 11),
    .holding = {SOC_PIN('C', 4), SOC_PIN('B', 2)},
    .vector_m1 = IRQ_ADC,
    .vector_m2 = IRQ_DMA2_STREAM2,
    .vector_start = IRQ_ADC,
    .boot_clocks = 100000u * BOARD_CLOCK_MHZ,
};

/* ---- analogue inputs ------------------------------------------------------------------------------------------------ */

typedef enum { NOTHING, CURRENT, BUS, TEMPERATURE } analog_kind_t;

/* By the input of the converters. There are shunts in the phases b and c, at amplifiers 1 and 2 of the gate driver. */
static const struct {
    analog_kind_t kind;
    uint8_t axis, phase, pin;
} analog[16] = {
    [ADC123_IN_C0] = {CURRENT, 0, 1, SOC_PIN('C', 0)},    [ADC123_IN_C1] = {CURRENT, 0, 2, SOC_PIN('C', 1)},
    [ADC123_IN_C3] = {CURRENT, 1, 1, SOC_PIN('C', 3)},    [ADC123_IN_C2] = {CURRENT, 1, 2, SOC_PIN('C', 2)},
    [ADC12_IN_A6] = {BUS, 0, 0, SOC_PIN('A', 6)},         [ADC12_IN_C5] = {TEMPERATURE, 0, 0, SOC_PIN('C', 5)},
    [ADC12_IN_A4] = {TEMPERATURE, 1, 0, SOC_PIN('A', 4)},
};

static uint16_t current_code(board_t *board, unsigned axis, unsigned phase)
{
    const drv8301_t *drivers = &board->chip.drivers;
    const int code = (int)switching_current_code(&board->plant, (int)axis, (int)phase) - MIDDLE;
    if (drv8301_calibrates(drivers, axis, phase - 1u)) {
        return MIDDLE;
    }
    return (uint16_t)(MIDDLE + code * (int)drv8301_gain(drivers, axis) / (int)FULL_GAIN);
}

uint16_t board_convert(void *self, unsigned channel)
{
    board_t *board = (board_t *)self;
    const unsigned axis = analog[channel].axis;
    if (!gpio_is_analog(&board->chip.gpio, analog[channel].pin)) {
        return 0;
    }
    switch (analog[channel].kind) {
    case CURRENT:
        return current_code(board, axis, analog[channel].phase);
    case BUS:
        return switching_bus_code(&board->plant);
    case TEMPERATURE:
        return plant_code_sink(board->plant.axis[axis].sink.t);
    default:
        return 0;
    }
}

/* ---- gates, over-current -------------------------------------------------------------------------------------------- */

void board_set_gates(void *self, unsigned module, unsigned submodule, unsigned levels)
{
    board_t *board = (board_t *)self;
    switching_edge(&board->plant, (int)module, (int)submodule, (switching_leg_t)levels);
}

void board_over_current(board_t *board, int axis, bool tripped)
{
    drv8301_over_current(&board->chip.drivers, (unsigned)axis, tripped);
}

/* ---- software: none is linked --------------------------------------------------------------------------------------- */

void board_boot(board_t *board) { (void)board; }

void board_interrupt(board_t *board, unsigned vector)
{
    (void)board;
    (void)vector;
}

void board_background(board_t *board) { (void)board; }

void board_run_linked(board_t *board, uint64_t until)
{
    bus_t *bus = &board->chip.soc.bus;
    (void)until;
    if (setjmp(bus->escape) == 0) {
        bus_fail(bus, "no firmware is linked with this board: it needs an ELF file");
    }
}

bool board_timeless(const board_t *board)
{
    (void)board;
    return false;
}

bool *board_stop_resting(board_t *board, bool on)
{
    (void)on;
    return &board->linked.resting;
}

void board_restored_linked(board_t *board)
{
    chip_show_storage(&board->chip);
    arm_forget(&board->program.arm);
}

const program_chip_t board_program_chip = {
    .port = "stm32f405",
    .flash = {FLASH_MEMORY, FLASH_MEMORY_SIZE},
    .flash_is_slow = true,
    .ram = {{CCM_MEMORY, CCM_MEMORY_SIZE}, {SRAM2_MEMORY, SRAM2_MEMORY_SIZE}},
    .code_ram = {SRAM1_MEMORY, SRAM1_MEMORY_SIZE},
    .read = chip_load,
    .write = chip_store,
    .reset = chip_reset_by_software,
    .power_on = chip_power_on,
};

/* ---- life ----------------------------------------------------------------------------------------------------------- */

static uint8_t *memory(void *board, uint32_t address, unsigned size)
{
    return program_memory(&((board_t *)board)->program, address, size);
}

void board_chip_init(board_t *board, const board_config_t *config, const chip_environment_t *environment)
{
    const chip_config_t chip = {
        .baud = config->baud,
        .flash = config->flash,
        .seed = config->seed,
        .enable_pin = SOC_PIN('B', 12),
        .select_pin = {SOC_PIN('C', 13), SOC_PIN('C', 14)},
        .fault_pin = SOC_PIN('D', 2),
        .memory = memory,
    };
    chip_init(&board->chip, &chip, environment, board);
}

void board_program_loaded(board_t *board) { chip_show_storage(&board->chip); }

uint64_t board_time_zero(const board_t *board)
{
    const tim_t *timer = &board->chip.tim[SOC_TIM1];
    uint64_t centre = timer->origin + timer->active_arr;
    while (centre <= board->chip.soc.bus.now) {
        centre += 2u * (uint64_t)timer->active_arr;
    }
    return centre;
}
