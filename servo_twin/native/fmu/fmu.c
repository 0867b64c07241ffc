/* A board as FMI 3.0 co-simulation. The exporter (fmu.py) writes fmu_variables.h: token, plant, variables of the firmware.
 *
 * Value references: REFERENCE_* plus an index into the inputs, the variables of the firmware, the numbers of board_truth_t of an
 * axis, or those of the plant's structures.
 */
#include "fmu/fmi3.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "board.h"
#include "config/board_gen.h"
#include "fmu_variables.h"

#define STEP_NS ((uint64_t)BOARD_PWM_PERIOD_NS) /* a communication step is a multiple of a PWM period */
#define STEP_TOLERANCE 1e-6 /* rounding of communication points [periods] */
#define BLOCK 1000u /* value references per block */

enum {
    REFERENCE_TIME,
    REFERENCE_INPUT = 1,
    REFERENCE_FIRMWARE,
    REFERENCE_TRUTH,
    REFERENCE_PLANT = 5,
    REFERENCE_BUS = 7
};
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
    uint64_t image_size; /* of the board's state behind this [bytes]; 0: no board yet */
    board_config_t config;
    double start; /* [s] */
    double input[INPUTS];
    double firmware[FIRMWARE_VALUES]; /* last written [SI] */
    bool written[FIRMWARE_VALUES];
} data_t;

typedef struct {
    data_t data;
    board_t *board; /* NULL: not initialised */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} instance_t;

static fmi3Status report(const instance_t *fmu, fmi3Status status, const char *what, const char *where)
{
    char text[300];
    (void)snprintf(text, sizeof text, "%s: %s", where, what);
    if (fmu->log != NULL) {
        fmu->log(fmu->environment, status, (status == fmi3Discard) ? "logStatusDiscard" : "logStatusError", text);
    }
    return status;
}

/* ---- life ----------------------------------------------------------------------------------------------------------- */

static void reset(instance_t *fmu)
{
    board_free(fmu->board);
    fmu->board = NULL;
    memset(&fmu->data, 0, sizeof fmu->data);
    fmu->data.token = EXPORT_TOKEN;
    fmu->data.config = exported_config;
    fmu->data.input[U_SOURCE] = exported_config.bus.u_source;
    for (size_t i = 0; i < BOARD_AXES; i++) {
        fmu->data.input[i * AXIS_INPUTS + TORQUE] = -exported_config.axis[i].load_torque;
    }
    for (size_t k = 0; k < FIRMWARE_VALUES; k++) {
        fmu->data.written[k] = firmware_values[k].initial;
        fmu->data.firmware[k] = firmware_values[k].start;
    }
}

FMI3_EXPORT const char *fmi3GetVersion(void);
const char *fmi3GetVersion(void) { return "3.0"; }

FMI3_EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String names[]);
fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String names[])
{
    (void)instance;
    (void)on;
    (void)n;
    (void)names;
    return fmi3OK;
}

FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                     fmi3Boolean early_return, const fmi3ValueReference variables[],
                                                     size_t n, fmi3InstanceEnvironment environment,
                                                     fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update);
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference variables[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)name;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)event_mode;
    (void)early_return;
    (void)variables;
    (void)n;
    (void)update;
    instance_t *fmu = (instance_t *)calloc(1, sizeof *fmu);
    if (fmu == NULL) {
        return NULL;
    }
    fmu->environment = environment;
    fmu->log = log;
    if (token == NULL || strcmp(token, INSTANTIATION_TOKEN) != 0) {
        (void)report(fmu, fmi3Error, "is not that of this binary; export the FMU again", "instantiationToken");
        free(fmu);
        return NULL;
    }
    reset(fmu);
    return fmu;
}

FMI3_EXPORT void fmi3FreeInstance(fmi3Instance instance);
void fmi3FreeInstance(fmi3Instance instance)
{
    instance_t *fmu = (instance_t *)instance;
    if (fmu != NULL) {
        board_free(fmu->board);
        free(fmu);
    }
}

FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance instance);
fmi3Status fmi3Reset(fmi3Instance instance)
{
    reset((instance_t *)instance);
    return fmi3OK;
}

/* ---- inputs --------------------------------------------------------------------------------------------------------- */

static void apply_fault(board_t *board, int axis, axis_fault_t fault, double value)
{
    const board_fault_t injected = {.kind = fault.kind, .axis = axis, .part = fault.part, .value = value};
    board_clear_fault(board, &injected);
    if (value != 0.0) {
        board_inject_fault(board, &injected);
    }
}

static void apply_input(instance_t *fmu, size_t index)
{
    const double value = fmu->data.input[index];
    const int axis = (int)(index / AXIS_INPUTS);
    if (fmu->board == NULL) {
        return;
    }
    if (index == U_SOURCE) {
        board_set_supply(fmu->board, value);
        return;
    }
    if (index % AXIS_INPUTS >= FIRST_FAULT) {
        apply_fault(fmu->board, axis, axis_faults[index % AXIS_INPUTS - FIRST_FAULT], value);
        return;
    }
    switch (index % AXIS_INPUTS) {
    case TORQUE:
        board_set_load(fmu->board, axis, -value); /* a load is against positive motion */
        break;
    case LOCKED:
        board_set_shaft(fmu->board, axis, value != 0.0);
        break;
    case MOTOR_OFF:
        board_set_motor(fmu->board, axis, value == 0.0);
        break;
    default:
        board_set_encoder(fmu->board, axis, value == 0.0);
        break;
    }
}

static fmi3Status set_input(instance_t *fmu, size_t index, double value)
{
    if (index >= INPUTS) {
        return report(fmu, fmi3Error, "no such input", "valueReference");
    }
    if ((index == U_SOURCE || index % AXIS_INPUTS >= FIRST_FAULT) && value < 0.0) {
        return report(fmu, fmi3Discard, "is negative", (index == U_SOURCE) ? "supply.u_source" : "fault");
    }
    const bool changed = fmu->data.input[index] != value;
    fmu->data.input[index] = value;
    if (changed) {
        apply_input(fmu, index);
    }
    return fmi3OK;
}

static bool write_firmware(const instance_t *fmu, size_t k)
{
    const firmware_value_t *value = &firmware_values[k];
    const double raw = floor(fmu->data.firmware[k] / value->lsb + 0.5);
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
    return board_write(fmu->board, value->address, bytes, value->size) == 0;
}

static fmi3Status set_firmware(instance_t *fmu, size_t k, double number)
{
    if (k >= FIRMWARE_VALUES || !firmware_values[k].writable) {
        return report(fmu, fmi3Error, "no such input", "valueReference");
    }
    const bool changed = !fmu->data.written[k] || fmu->data.firmware[k] != number;
    const double before = fmu->data.firmware[k];
    fmu->data.firmware[k] = number;
    if (changed && fmu->board != NULL && !write_firmware(fmu, k)) {
        fmu->data.firmware[k] = before;
        return report(fmu, fmi3Discard, "the firmware refuses the value", firmware_values[k].name);
    }
    fmu->data.written[k] = true;
    return fmi3OK;
}

/* The numbers of the plant that a value reference belongs to; NULL: none. */
static double *parameter(data_t *data, unsigned block, size_t index)
{
    if (block == REFERENCE_BUS) {
        return (index < BUS_NUMBERS) ? (double *)(void *)&data->config.bus + index : NULL;
    }
    return (index < AXIS_NUMBERS) ? (double *)(void *)&data->config.axis[block - REFERENCE_PLANT] + index : NULL;
}

static fmi3Status set_value(instance_t *fmu, fmi3ValueReference reference, double value)
{
    const unsigned block = reference / BLOCK;
    const size_t index = reference % BLOCK;
    if (isnan(value)) {
        return report(fmu, fmi3Discard, "the value is not a number", "set");
    }
    if (block == REFERENCE_INPUT) {
        return set_input(fmu, index, value);
    }
    if (block == REFERENCE_FIRMWARE) {
        return set_firmware(fmu, index, value);
    }
    double *place = (block >= REFERENCE_PLANT && block <= REFERENCE_BUS) ? parameter(&fmu->data, block, index) : NULL;
    if (place == NULL || fmu->board != NULL) {
        return report(fmu, fmi3Error, "no variable that can be set now", "valueReference");
    }
    const range_t *range = (block == REFERENCE_BUS) ? &bus_ranges[index] : &axis_ranges[index];
    if (value < range->minimum || value > range->maximum || (range->whole && floor(value) != value)) {
        return report(fmu, fmi3Discard, "is outside of its range; see min and max, or it is not a whole number",
                      range->name);
    }
    *place = value;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                      const fmi3Float64 values[], size_t n_values);
fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                          const fmi3Float64 values[], size_t n_values)
{
    fmi3Status status = (n == n_values) ? fmi3OK : fmi3Error;
    for (size_t k = 0; k < n && status == fmi3OK; k++) {
        status = set_value((instance_t *)instance, references[k], values[k]);
    }
    return status;
}

/* ---- outputs -------------------------------------------------------------------------------------------------------- */

static bool read_firmware(const instance_t *fmu, size_t k, double *number)
{
    const firmware_value_t *value = &firmware_values[k];
    uint8_t bytes[4] = {0};
    if (value->writable || fmu->board == NULL) {
        *number = fmu->data.firmware[k];
        return true;
    }
    if (board_read(fmu->board, value->address, bytes, value->size) != 0) {
        return false;
    }
    int64_t raw = 0;
    for (unsigned n = 0; n < value->size; n++) {
        raw |= (int64_t)bytes[n] << (8u * n);
    }
    const int64_t range = INT64_C(1) << (8 * value->size);
    *number = (double)((value->is_signed && raw >= range / 2) ? raw - range : raw) * value->lsb;
    return true;
}

static bool get_value(instance_t *fmu, fmi3ValueReference reference, double *value)
{
    const unsigned block = reference / BLOCK;
    const size_t index = reference % BLOCK;
    *value = 0.0;
    if (reference == REFERENCE_TIME) {
        *value = fmu->data.start + ((fmu->board != NULL) ? 1e-9 * (double)board_time_ns(fmu->board) : 0.0);
        return true;
    }
    if (block == REFERENCE_INPUT && index < INPUTS) {
        *value = fmu->data.input[index];
        return true;
    }
    if (block == REFERENCE_FIRMWARE && index < FIRMWARE_VALUES) {
        return read_firmware(fmu, index, value);
    }
    if (block >= REFERENCE_TRUTH && block < REFERENCE_TRUTH + BOARD_AXES && index < TRUTH_NUMBERS) {
        if (fmu->board != NULL) {
            board_truth_t truth;
            board_truth(fmu->board, (int)(block - REFERENCE_TRUTH), &truth);
            memcpy(value, (const uint8_t *)&truth + index * sizeof(double), sizeof *value);
        }
        return true;
    }
    const double *place =
        (block >= REFERENCE_PLANT && block <= REFERENCE_BUS) ? parameter(&fmu->data, block, index) : NULL;
    if (place != NULL) {
        *value = *place;
    }
    return place != NULL;
}

FMI3_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                      fmi3Float64 values[], size_t n_values);
fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Float64 values[],
                          size_t n_values)
{
    instance_t *fmu = (instance_t *)instance;
    for (size_t k = 0; k < n; k++) {
        if (n != n_values || !get_value(fmu, references[k], &values[k])) {
            return report(fmu, fmi3Error, "no such variable", "valueReference");
        }
    }
    return fmi3OK;
}

/* ---- simulation ----------------------------------------------------------------------------------------------------- */

FMI3_EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_given, double tolerance,
                                                   double start, fmi3Boolean stop_given, double stop);
fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_given, double tolerance,
                                       double start, fmi3Boolean stop_given, double stop)
{
    instance_t *fmu = (instance_t *)instance;
    (void)tolerance_given;
    (void)tolerance;
    (void)stop_given;
    (void)stop;
    fmu->data.start = start;
    fmu->board = board_new(&fmu->data.config);
    if (fmu->board == NULL) {
        return report(fmu, fmi3Error, "no memory for another board", "initialization");
    }
    for (size_t k = 0; k < INPUTS; k++) {
        apply_input(fmu, k);
    }
    for (size_t k = 0; k < FIRMWARE_VALUES; k++) {
        if (fmu->data.written[k] && !write_firmware(fmu, k)) {
            return report(fmu, fmi3Error, "the firmware refuses the value", firmware_values[k].name);
        }
    }
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance instance);
fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    (void)instance;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance instance);
fmi3Status fmi3Terminate(fmi3Instance instance)
{
    (void)instance;
    return fmi3OK;
}

/* The number of PWM periods in a time, if it is a whole one. */
static bool whole_periods(double seconds, double *periods)
{
    const double number = seconds / (1e-9 * (double)STEP_NS);
    *periods = floor(number + 0.5);
    return fabs(number - *periods) <= STEP_TOLERANCE * (1.0 + 1e-6 * *periods) && *periods < 1e12;
}

FMI3_EXPORT fmi3Status fmi3DoStep(fmi3Instance instance, double point, double size, fmi3Boolean no_set_state,
                                  fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, double *last);
fmi3Status fmi3DoStep(fmi3Instance instance, double point, double size, fmi3Boolean no_set_state, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, double *last)
{
    instance_t *fmu = (instance_t *)instance;
    double from;
    double periods;
    (void)no_set_state;
    *event = *terminate = *early = false;
    *last = point;
    if (fmu->board == NULL) {
        return report(fmu, fmi3Error, "the board is not initialised", "doStep");
    }
    const uint64_t now_ns = board_time_ns(fmu->board);
    if (!whole_periods(point - fmu->data.start, &from) || (uint64_t)from * STEP_NS != now_ns) {
        return report(fmu, fmi3Discard, "is not the end of the last step; to go back, set a saved FMU state",
                      "currentCommunicationPoint");
    }
    if (!whole_periods(size, &periods) || periods < 1.0) {
        return report(fmu, fmi3Discard, "is not a multiple of a PWM period; choose one", "communicationStepSize");
    }
    board_advance(fmu->board, now_ns + (uint64_t)periods * STEP_NS);
    *last = point + size;
    return fmi3OK;
}

/* ---- state ---------------------------------------------------------------------------------------------------------- */

/* A state is a data_t and the image of the board behind it. */
static size_t state_size(const data_t *state) { return sizeof *state + (size_t)state->image_size; }

FMI3_EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state);
fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    (void)instance;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state);
fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    instance_t *fmu = (instance_t *)instance;
    size_t size = 0;
    const char *problem = (fmu->board != NULL) ? board_save(fmu->board, NULL, 0, &size) : NULL;
    data_t *saved = (problem == NULL) ? (data_t *)realloc(*state, sizeof *saved + size) : NULL;
    if (saved == NULL) {
        return report(fmu, fmi3Error, (problem != NULL) ? problem : "no memory", "FMU state");
    }
    *saved = fmu->data;
    saved->image_size = size;
    if (size > 0) {
        (void)board_save(fmu->board, (uint8_t *)(saved + 1), size, &size);
    }
    *state = saved;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state);
fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    instance_t *fmu = (instance_t *)instance;
    const data_t *saved = (const data_t *)state;
    if (saved == NULL) {
        return report(fmu, fmi3Error, "is NULL", "FMU state");
    }
    if (saved->image_size == 0) {
        board_free(fmu->board);
        fmu->board = NULL;
    } else {
        board_t *board = (fmu->board != NULL) ? fmu->board : board_new(&exported_config);
        const char *problem = (board != NULL) ? board_restore(board, (const uint8_t *)(saved + 1), saved->image_size)
                                              : "no memory for another board";
        if (problem != NULL) {
            if (fmu->board == NULL) {
                board_free(board);
            }
            return report(fmu, fmi3Error, problem, "FMU state");
        }
        fmu->board = board;
    }
    fmu->data = *saved;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size);
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    (void)instance;
    *size = state_size((const data_t *)state);
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size);
fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if (size < state_size((const data_t *)state)) {
        return report((instance_t *)instance, fmi3Error, "the memory is too small", "serialized FMU state");
    }
    memcpy(bytes, state, state_size((const data_t *)state));
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size,
                                               fmi3FMUState *state);
fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    instance_t *fmu = (instance_t *)instance;
    data_t head = {0};
    memcpy(&head, bytes, (size < sizeof head) ? size : sizeof head);
    if (size < sizeof head || head.token != EXPORT_TOKEN || state_size(&head) != size) {
        return report(fmu, fmi3Error, "is incomplete, or that of another export", "serialized FMU state");
    }
    void *copy = realloc(*state, size);
    if (copy == NULL) {
        return report(fmu, fmi3Error, "no memory", "serialized FMU state");
    }
    memcpy(copy, bytes, size);
    *state = copy;
    return fmi3OK;
}

/* ---- what the model description does not announce; an importer that binds every function finds it --------------------- */

#define REFUSED(name)                                                                                                  \
    FMI3_EXPORT int name(void);                                                                                        \
    int name(void) { return fmi3Error; }

FMI3_EXPORT fmi3Instance fmi3InstantiateModelExchange(void);
fmi3Instance fmi3InstantiateModelExchange(void) { return NULL; }
FMI3_EXPORT fmi3Instance fmi3InstantiateScheduledExecution(void);
fmi3Instance fmi3InstantiateScheduledExecution(void) { return NULL; }
REFUSED(fmi3EnterEventMode)
REFUSED(fmi3GetFloat32)
REFUSED(fmi3GetInt8)
REFUSED(fmi3GetUInt8)
REFUSED(fmi3GetInt16)
REFUSED(fmi3GetUInt16)
REFUSED(fmi3GetInt32)
REFUSED(fmi3GetUInt32)
REFUSED(fmi3GetInt64)
REFUSED(fmi3GetUInt64)
REFUSED(fmi3GetBoolean)
REFUSED(fmi3GetString)
REFUSED(fmi3GetBinary)
REFUSED(fmi3GetClock)
REFUSED(fmi3SetFloat32)
REFUSED(fmi3SetInt8)
REFUSED(fmi3SetUInt8)
REFUSED(fmi3SetInt16)
REFUSED(fmi3SetUInt16)
REFUSED(fmi3SetInt32)
REFUSED(fmi3SetUInt32)
REFUSED(fmi3SetInt64)
REFUSED(fmi3SetUInt64)
REFUSED(fmi3SetBoolean)
REFUSED(fmi3SetString)
REFUSED(fmi3SetBinary)
REFUSED(fmi3SetClock)
REFUSED(fmi3GetNumberOfVariableDependencies)
REFUSED(fmi3GetVariableDependencies)
REFUSED(fmi3GetDirectionalDerivative)
REFUSED(fmi3GetAdjointDerivative)
REFUSED(fmi3EnterConfigurationMode)
REFUSED(fmi3ExitConfigurationMode)
REFUSED(fmi3GetIntervalDecimal)
REFUSED(fmi3GetIntervalFraction)
REFUSED(fmi3GetShiftDecimal)
REFUSED(fmi3GetShiftFraction)
REFUSED(fmi3SetIntervalDecimal)
REFUSED(fmi3SetIntervalFraction)
REFUSED(fmi3SetShiftDecimal)
REFUSED(fmi3SetShiftFraction)
REFUSED(fmi3EvaluateDiscreteStates)
REFUSED(fmi3UpdateDiscreteStates)
REFUSED(fmi3EnterContinuousTimeMode)
REFUSED(fmi3CompletedIntegratorStep)
REFUSED(fmi3SetTime)
REFUSED(fmi3SetContinuousStates)
REFUSED(fmi3GetContinuousStateDerivatives)
REFUSED(fmi3GetEventIndicators)
REFUSED(fmi3GetContinuousStates)
REFUSED(fmi3GetNominalsOfContinuousStates)
REFUSED(fmi3GetNumberOfEventIndicators)
REFUSED(fmi3GetNumberOfContinuousStates)
REFUSED(fmi3EnterStepMode)
REFUSED(fmi3GetOutputDerivatives)
REFUSED(fmi3ActivateModelPartition)
