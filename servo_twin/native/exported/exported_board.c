#include "exported/exported_board.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "exported_variables.h"

enum {
    TORQUE,
    LOCKED,
    MOTOR_OFF,
    ENCODER_OFF,
    FIRST_FAULT, /* of axis_faults[]; each input is its value, 0: no fault */
    AXIS_INPUTS = FIRST_FAULT + (int)(sizeof axis_faults / sizeof axis_faults[0]),
    U_SOURCE = BOARD_AXES * AXIS_INPUTS,
    INPUTS
};

#define FIRMWARE_VALUES (sizeof firmware_values / sizeof firmware_values[0])
#define TRUTH_NUMBERS (sizeof(board_truth_t) / sizeof(double))
#define AXIS_NUMBERS (sizeof(plant_axis_t) / sizeof(double))
#define BUS_NUMBERS (sizeof(plant_bus_t) / sizeof(double))

/* All but the board. */
typedef struct {
    uint64_t token; /* of the export */
    uint64_t check; /* sum of the data behind it */
    uint64_t image_size; /* of the board's state behind this [bytes]; 0: not started */
    board_config_t config;
    double start; /* [s] */
    double input[INPUTS];
    bool given[INPUTS]; /* otherwise it is that of the plant, or 0 */
    double firmware[FIRMWARE_VALUES]; /* last written [SI] */
    bool written[FIRMWARE_VALUES];
} data_t;

struct exported {
    data_t data;
    board_t *board; /* NULL: not started */
};

static const exported_result_t done = {EXPORTED_DONE, NULL, NULL};

static exported_result_t refused(const char *what, const char *where)
{
    return (exported_result_t){EXPORTED_REFUSED, what, where};
}

static exported_result_t failed(const char *what, const char *where)
{
    return (exported_result_t){EXPORTED_FAILED, what, where};
}

/* ---- life ----------------------------------------------------------------------------------------------------------- */

const char *exported_token(void) { return INSTANTIATION_TOKEN; }

const exported_variable_t *exported_variables(size_t *n)
{
    *n = sizeof exported_names / sizeof exported_names[0];
    return exported_names;
}

const exported_variable_t *exported_variable(const char *name)
{
    for (size_t k = 0; k < sizeof exported_names / sizeof exported_names[0]; k++) {
        if (strcmp(exported_names[k].name, name) == 0) {
            return &exported_names[k];
        }
    }
    return NULL;
}

/* For messages. */
static const char *name_of(uint32_t reference)
{
    size_t k = 0;
    while (k < sizeof exported_names / sizeof exported_names[0] && exported_names[k].reference != reference) {
        k++;
    }
    return (k < sizeof exported_names / sizeof exported_names[0]) ? exported_names[k].name : "valueReference";
}

const char *exported_fault_name(unsigned bit)
{
    return (bit < sizeof fault_names / sizeof fault_names[0] && fault_names[bit] != NULL) ? fault_names[bit] : "";
}

exported_t *exported_new(void)
{
    exported_t *exported = (exported_t *)calloc(1, sizeof *exported);
    if (exported != NULL) {
        exported_reset(exported);
    }
    return exported;
}

void exported_free(exported_t *exported)
{
    if (exported != NULL) {
        board_free(exported->board);
        free(exported);
    }
}

/* Inputs that have a parameter of the plant, unless they are given. */
static void inputs_of_plant(data_t *data)
{
    if (!data->given[U_SOURCE]) {
        data->input[U_SOURCE] = data->config.bus.u_source;
    }
    for (size_t i = 0; i < BOARD_AXES; i++) {
        if (!data->given[i * AXIS_INPUTS + TORQUE]) {
            data->input[i * AXIS_INPUTS + TORQUE] = -data->config.axis[i].load_torque;
        }
    }
}

void exported_reset(exported_t *exported)
{
    data_t *data = &exported->data;
    board_free(exported->board);
    exported->board = NULL;
    memset(data, 0, sizeof *data);
    data->token = EXPORT_TOKEN;
    data->config = exported_config;
    inputs_of_plant(data);
    for (size_t k = 0; k < FIRMWARE_VALUES; k++) {
        data->written[k] = firmware_values[k].initial;
        data->firmware[k] = firmware_values[k].start;
    }
}

board_t *exported_board(const exported_t *exported) { return exported->board; }

double exported_start_time(const exported_t *exported) { return exported->data.start; }

/* ---- inputs --------------------------------------------------------------------------------------------------------- */

static void apply_fault(board_t *board, int axis, axis_fault_t fault, double value)
{
    const board_fault_t injected = {.kind = fault.kind, .axis = axis, .part = fault.part, .value = value};
    board_clear_fault(board, &injected);
    if (value != 0.0) {
        board_inject_fault(board, &injected);
    }
}

static void apply_input(exported_t *exported, size_t index)
{
    const double value = exported->data.input[index];
    const int axis = (int)(index / AXIS_INPUTS);
    board_t *board = exported->board;
    if (board == NULL) {
        return;
    }
    if (index == U_SOURCE) {
        board_set_supply(board, value);
        return;
    }
    if (index % AXIS_INPUTS >= FIRST_FAULT) {
        apply_fault(board, axis, axis_faults[index % AXIS_INPUTS - FIRST_FAULT], value);
        return;
    }
    switch (index % AXIS_INPUTS) {
    case TORQUE:
        board_set_load(board, axis, -value); /* a load is against positive motion */
        break;
    case LOCKED:
        board_set_shaft(board, axis, value != 0.0);
        break;
    case MOTOR_OFF:
        board_set_motor(board, axis, value == 0.0);
        break;
    default:
        board_set_encoder(board, axis, value == 0.0);
        break;
    }
}

static exported_result_t set_input(exported_t *exported, size_t index, double value)
{
    if (index >= INPUTS) {
        return failed("no such input", "valueReference");
    }
    if (isinf(value)) {
        return refused("the value is infinite", name_of(EXPORTED_INPUT * EXPORTED_BLOCK + (uint32_t)index));
    }
    if ((index == U_SOURCE || index % AXIS_INPUTS >= FIRST_FAULT) && value < 0.0) {
        return refused("is negative", name_of(EXPORTED_INPUT * EXPORTED_BLOCK + (uint32_t)index));
    }
    const bool changed = exported->data.input[index] != value;
    exported->data.input[index] = value;
    exported->data.given[index] = true;
    if (changed) {
        apply_input(exported, index);
    }
    return done;
}

static bool write_firmware(const exported_t *exported, size_t k)
{
    const firmware_value_t *value = &firmware_values[k];
    const double raw = floor(exported->data.firmware[k] / value->lsb + 0.5);
    if (!(fabs(raw) < 9e15)) {
        return false;
    }
    const int64_t integer = (int64_t)raw;
    const int64_t largest = (INT64_C(1) << (8 * value->size - (value->is_signed ? 1 : 0))) - 1;
    if (integer > largest || integer < (value->is_signed ? -largest - 1 : 0)) {
        return false;
    }
    uint8_t bytes[4];
    for (unsigned n = 0; n < value->size; n++) {
        bytes[n] = (uint8_t)((uint64_t)integer >> (8u * n));
    }
    return board_write(exported->board, value->address, bytes, value->size) == 0;
}

static exported_result_t set_firmware(exported_t *exported, size_t k, double number)
{
    data_t *data = &exported->data;
    if (k >= FIRMWARE_VALUES || !firmware_values[k].writable) {
        return failed("is no input", name_of(EXPORTED_FIRMWARE * EXPORTED_BLOCK + (uint32_t)k));
    }
    const bool changed = !data->written[k] || data->firmware[k] != number;
    const double before = data->firmware[k];
    data->firmware[k] = number;
    if (changed && exported->board != NULL && !write_firmware(exported, k)) {
        data->firmware[k] = before;
        return refused("the firmware refuses the value", firmware_values[k].name);
    }
    data->written[k] = true;
    return done;
}

/* The numbers of the plant that a value reference belongs to; NULL: none. */
static double *parameter(board_config_t *config, unsigned block, size_t index)
{
    if (block == EXPORTED_BUS) {
        return (index < BUS_NUMBERS) ? (double *)(void *)&config->bus + index : NULL;
    }
    return (block >= EXPORTED_PLANT && block < EXPORTED_BUS && index < AXIS_NUMBERS)
               ? (double *)(void *)&config->axis[block - EXPORTED_PLANT] + index
               : NULL;
}

exported_result_t exported_set(exported_t *exported, uint32_t reference, double value)
{
    const unsigned block = reference / EXPORTED_BLOCK;
    const size_t index = reference % EXPORTED_BLOCK;
    if (isnan(value)) {
        return refused("the value is not a number", name_of(reference));
    }
    if (block == EXPORTED_INPUT) {
        return set_input(exported, index, value);
    }
    if (block == EXPORTED_FIRMWARE) {
        return set_firmware(exported, index, value);
    }
    double *place = parameter(&exported->data.config, block, index);
    if (place == NULL || exported->board != NULL) {
        return failed("cannot be set now", name_of(reference));
    }
    const range_t *range = (block == EXPORTED_BUS) ? &bus_ranges[index] : &axis_ranges[index];
    if (value < range->minimum || value > range->maximum || (range->whole && floor(value) != value)) {
        return refused("is outside of its range; see min and max, or it is not a whole number", range->name);
    }
    *place = value;
    inputs_of_plant(&exported->data);
    return done;
}

/* ---- outputs -------------------------------------------------------------------------------------------------------- */

static exported_result_t read_firmware(const exported_t *exported, size_t k, double *number)
{
    const firmware_value_t *value = &firmware_values[k];
    uint8_t bytes[4] = {0};
    if (value->writable || exported->board == NULL) {
        *number = exported->data.firmware[k];
        return done;
    }
    if (board_read(exported->board, value->address, bytes, value->size) != 0) {
        return failed("the firmware does not give it", value->name);
    }
    int64_t raw = 0;
    for (unsigned n = 0; n < value->size; n++) {
        raw |= (int64_t)bytes[n] << (8u * n);
    }
    const int64_t range = INT64_C(1) << (8 * value->size);
    *number = (double)((value->is_signed && raw >= range / 2) ? raw - range : raw) * value->lsb;
    return done;
}

exported_result_t exported_get(const exported_t *exported, uint32_t reference, double *value)
{
    const unsigned block = reference / EXPORTED_BLOCK;
    const size_t index = reference % EXPORTED_BLOCK;
    board_t *board = exported->board;
    *value = 0.0;
    if (reference == EXPORTED_TIME) {
        *value = exported->data.start + ((board != NULL) ? 1e-9 * (double)board_time_ns(board) : 0.0);
        return done;
    }
    if (block == EXPORTED_INPUT && index < INPUTS) {
        *value = exported->data.input[index];
        return done;
    }
    if (block == EXPORTED_FIRMWARE && index < FIRMWARE_VALUES) {
        return read_firmware(exported, index, value);
    }
    if (block >= EXPORTED_TRUTH && block < EXPORTED_TRUTH + BOARD_AXES && index < TRUTH_NUMBERS) {
        if (board != NULL) {
            board_truth_t truth;
            board_truth(board, (int)(block - EXPORTED_TRUTH), &truth);
            memcpy(value, (const uint8_t *)&truth + index * sizeof(double), sizeof *value);
        }
        return done;
    }
    board_config_t config = exported->data.config;
    const double *place = parameter(&config, block, index);
    if (place == NULL) {
        return failed("no such variable", "valueReference");
    }
    *value = *place;
    return done;
}

double exported_number(const exported_t *exported, uint32_t reference)
{
    double value;
    (void)exported_get(exported, reference, &value);
    return value;
}

/* ---- points of a path ----------------------------------------------------------------------------------------------- */

#define POINT_PART_BITS 12u /* fraction of a position */

/* Smallest step of a quantity of the first axis, which is that of points. */
static double lsb_of(const char *name)
{
    size_t k = 0;
    while (strcmp(firmware_values[k].name, name) != 0) {
        k++;
    }
    return firmware_values[k].lsb;
}

#define POINT_WORDS 4u

exported_result_t exported_points(const exported_t *exported, const exported_point_t *points, size_t n)
{
    uint8_t bytes[4 * POINT_WORDS * BOARD_AXES];
    for (size_t k = 0; k < n; k++) {
        const double fine =
            floor(points[k].position / lsb_of("axis1.position") * (double)(1u << POINT_PART_BITS) + 0.5);
        const double speed = floor(points[k].velocity / lsb_of("axis1.speed") + 0.5);
        if (!(fabs(fine) < 9e15) || !(fabs(speed) < 2147483648.0)) {
            return refused("is out of the range of the firmware", "point");
        }
        const uint64_t whole = (uint64_t)(int64_t)fine;
        const uint32_t part = (uint32_t)(whole & ((1u << POINT_PART_BITS) - 1u));
        const uint32_t word[POINT_WORDS] = {points[k].tick, (uint32_t)(whole >> POINT_PART_BITS),
                                            (uint32_t)(int32_t)speed, part << 16 | (uint32_t)points[k].axis << 28};
        for (size_t i = 0; i < 4 * POINT_WORDS; i++) {
            bytes[4 * POINT_WORDS * k + i] = (uint8_t)(word[i / 4] >> (8 * (i % 4)));
        }
    }
    return (board_write(exported->board, points_address, bytes, (uint16_t)(4 * POINT_WORDS * n)) == 0)
               ? done
               : refused("is not accepted now", "point");
}

/* ---- start and state ------------------------------------------------------------------------------------------------ */

exported_result_t exported_start(exported_t *exported, double time)
{
    exported->data.start = time;
    board_config_t config = exported->data.config;
    config.servo = exported_servo; /* not in the data, which are the same in every process */
    exported->board = board_new(&config);
    if (exported->board == NULL) {
        return failed("no memory for another board", "initialization");
    }
    for (size_t k = 0; k < INPUTS; k++) {
        apply_input(exported, k);
    }
    for (size_t k = 0; k < FIRMWARE_VALUES; k++) {
        if (exported->data.written[k] && !write_firmware(exported, k)) {
            return failed("the firmware refuses the value", firmware_values[k].name);
        }
    }
    return done;
}

#define CHECKED offsetof(data_t, image_size)

static uint64_t check_of(const uint8_t *state) { return board_check_sum(state + CHECKED, sizeof(data_t) - CHECKED); }

/* A state is a data_t and the image of the board behind it. */
exported_result_t exported_save(const exported_t *exported, uint8_t *state, size_t room, size_t *size)
{
    size_t image_size = 0;
    uint8_t *image = (room >= sizeof(data_t)) ? state + sizeof(data_t) : NULL;
    if (exported->board != NULL) {
        const char *problem =
            board_save(exported->board, image, (image != NULL) ? room - sizeof(data_t) : 0, &image_size);
        if (problem != NULL) {
            return failed(problem, "state");
        }
    }
    *size = sizeof(data_t) + image_size;
    if (*size <= room) {
        data_t data = exported->data;
        data.image_size = image_size;
        memcpy(state, &data, sizeof data);
        data.check = check_of(state);
        memcpy(state + offsetof(data_t, check), &data.check, sizeof data.check);
    }
    return done;
}

const char *exported_state_problem(const uint8_t *state, size_t size)
{
    data_t data = {0};
    memcpy(&data, state, (size < sizeof data) ? size : sizeof data);
    if (size < sizeof data || data.token != EXPORT_TOKEN || data.image_size != size - sizeof data) {
        return "is incomplete, or that of another export";
    }
    return (data.check != check_of(state)) ? "is damaged" : NULL;
}

exported_result_t exported_restore(exported_t *exported, const uint8_t *state, size_t size)
{
    const char *problem = exported_state_problem(state, size);
    if (problem != NULL) {
        return failed(problem, "state");
    }
    const size_t image_size = size - sizeof(data_t);
    if (image_size == 0) {
        board_free(exported->board);
        exported->board = NULL;
    } else {
        board_t *board = (exported->board != NULL) ? exported->board : board_new(&exported_config);
        problem =
            (board != NULL) ? board_restore(board, state + sizeof(data_t), image_size) : "no memory for another board";
        if (problem != NULL) {
            if (exported->board == NULL) {
                board_free(board);
            }
            return failed(problem, "state");
        }
        exported->board = board;
    }
    memcpy(&exported->data, state, sizeof exported->data);
    return done;
}
