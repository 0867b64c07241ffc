#include "registers/register_chip.h"

#include <string.h>

#define CROSSBAR_CLOCKS 2u
#define CLOCKS_PER_INSTRUCTION 1.25

/* Instructions of a Cortex-M3 at -O2, with what the port adds. */
#define CLOCKS(instructions) ((uint32_t)((instructions) * CLOCKS_PER_INSTRUCTION))

#define VECTOR_M1 85u
#define VECTOR_M2 30u
#define VECTOR_START 87u
#define VECTOR_EDGE_1 28u
#define VECTOR_EDGE_2 24u
#define VECTOR_RECEIVE 52u

/* ---- what is soldered to which pin ---------------------------------------------------------------------------------- */

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

static const uint8_t encoder_pin[BOARD_AXES][2] = {
    {CHIP_PIN('C', 3), CHIP_PIN('C', 4)},
    {CHIP_PIN('C', 2), CHIP_PIN('F', 8)},
};

static const uint8_t over_current_pin[BOARD_AXES] = {CHIP_PIN('E', 8), CHIP_PIN('F', 14)};

/* Phase whose shunt is at an analogue pin ANA0-7, ANB0-7. */
typedef struct {
    int8_t axis, phase;
} shunt_t;

#define NO_SHUNT {-1, -1}

static const shunt_t shunts[16] = {
    {0, 0}, {0, 1}, NO_SHUNT, NO_SHUNT, {1, 0}, {1, 1}, NO_SHUNT, NO_SHUNT,
    {0, 1}, {0, 2}, NO_SHUNT, NO_SHUNT, {1, 1}, {1, 2}, NO_SHUNT, NO_SHUNT,
};

#define CHANNEL_BUS 6u
#define CHANNEL_SINK_1 14u
#define CHANNEL_SINK_2 15u

/* Temperature sensors: 10 mV/K from 0 deg C on, 3.3 V full scale. */
#define SINK_CODES_PER_KELVIN (4096.0 * 0.01 / 3.3)

/* ---- plant ---------------------------------------------------------------------------------------------------------- */

static void advance(void *context, uint64_t clock)
{
    register_chip_t *board = (register_chip_t *)context;
    switching_advance(&board->plant, clock);
}

static uint64_t next(void *context)
{
    register_chip_t *board = (register_chip_t *)context;
    return switching_next(&board->plant);
}

static void events(void *context)
{
    register_chip_t *board = (register_chip_t *)context;
    switching_event_t event;
    while (switching_take(&board->plant, &event)) {
        if (event.kind == SWITCHING_ENCODER) {
            chip_pin(&board->chip, encoder_pin[event.axis][event.line], event.level);
        } else {
            board->breaks += event.level ? 1u : 0u;
            chip_pin(&board->chip, over_current_pin[event.axis], event.level);
        }
    }
}

static void gates(void *context, unsigned module, unsigned submodule, unsigned levels)
{
    register_chip_t *board = (register_chip_t *)context;
    switching_edge(&board->plant, (int)module, (int)submodule, (switching_leg_t)levels);
}

static uint16_t sink_code(const switching_t *plant, int axis)
{
    switching_truth_t truth;
    switching_truth(plant, axis, &truth);
    const double code = truth.t_sink * SINK_CODES_PER_KELVIN;
    return (uint16_t)((code < 0.0) ? 0.0 : (code > 4095.0) ? 4095.0 : code);
}

static uint16_t convert(void *context, unsigned channel)
{
    register_chip_t *board = (register_chip_t *)context;
    const shunt_t shunt = shunts[channel];
    if (shunt.axis >= 0) {
        return switching_current_code(&board->plant, shunt.axis, shunt.phase);
    }
    switch (channel) {
    case CHANNEL_BUS:
        return switching_bus_code(&board->plant);
    case CHANNEL_SINK_1:
        return sink_code(&board->plant, 0);
    case CHANNEL_SINK_2:
        return sink_code(&board->plant, 1);
    default:
        return 0; /* open */
    }
}

/* ---- software --------------------------------------------------------------------------------------------------------- */

static void boot(void *context)
{
    register_chip_t *board = (register_chip_t *)context;
    memset(board->servo, 0, sizeof *board->servo);
    memset(&board->hal, 0, sizeof board->hal);
    board->hal.chip = &board->chip;
    board->boots++;
    board->started = port_init(&board->hal, board->servo);
}

/* The slow loops run in every eighth period; a lost scan leaves the loops out. */
static uint32_t loop_cost(const register_chip_t *board, bool ran, bool slow, uint32_t fast_clocks, uint32_t slow_clocks)
{
    return !ran ? board->cost.lost : slow ? slow_clocks : fast_clocks;
}

static uint32_t interrupt(void *context, unsigned vector)
{
    register_chip_t *board = (register_chip_t *)context;
    const register_cost_t *cost = &board->cost;
    const servo_t *servo = board->servo;
    const uint32_t restarts = board->hal.restarts;
    const bool slow_before = servo->slow_tick;
    port_isr(&board->hal, (uint16_t)vector);
    const bool ran = board->hal.restarts == restarts;
    switch (vector) {
    case VECTOR_M1:
        return loop_cost(board, ran, servo->slow_tick, cost->m1, cost->m1_slow);
    case VECTOR_M2:
        board->scans++;
        board->chip.stop = board->stop_after_scan;
        return loop_cost(board, ran, slow_before, cost->m2, cost->m2_slow);
    case VECTOR_START:
        return cost->start;
    case VECTOR_EDGE_1:
    case VECTOR_EDGE_2:
        return cost->edge;
    case VECTOR_RECEIVE:
        return cost->receive;
    default:
        return cost->over_current;
    }
}

static void background(void *context)
{
    register_chip_t *board = (register_chip_t *)context;
    if (board->started) {
        servo_background(board->servo);
    }
}

/* ---- life ------------------------------------------------------------------------------------------------------------- */

void register_chip_init(register_chip_t *board, const board_config_t *config, servo_t *servo)
{
    memset(board, 0, sizeof *board);
    board->servo = servo;
    board->cost = (register_cost_t){
        .m1 = CLOCKS(560),
        .m1_slow = CLOCKS(1680),
        .m2 = CLOCKS(560),
        .m2_slow = CLOCKS(1320),
        .start = CLOCKS(40),
        .edge = CLOCKS(90),
        .receive = CLOCKS(50),
        .over_current = CLOCKS(120),
        .lost = CLOCKS(120),
    };
    switching_init(&board->plant, config);
    const chip_config_t chip_config = {.wiring = wiring, .baud = config->baud, .crossbar_clocks = CROSSBAR_CLOCKS};
    const chip_world_t world = {
        .context = board,
        .advance = advance,
        .next = next,
        .events = events,
        .gates = gates,
        .convert = convert,
        .boot = boot,
        .interrupt = interrupt,
        .background = background,
    };
    chip_init(&board->chip, &chip_config, &world);
    for (int axis = 0; axis < BOARD_AXES; axis++) {
        for (int line = 0; line < 2; line++) {
            chip_pin(&board->chip, encoder_pin[axis][line], switching_line(&board->plant, axis, line));
        }
        chip_pin(&board->chip, over_current_pin[axis], switching_over_current(&board->plant, axis));
    }
}

bool register_chip_run(register_chip_t *board, uint64_t until, bool stop_after_scan)
{
    board->stop_after_scan = stop_after_scan;
    board->chip.stop = false;
    return chip_run(&board->chip, until) && board->chip.stop;
}
