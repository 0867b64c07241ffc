/* A board as FMI 3.0 co-simulation. Value references are those of exported_board.h. */
#include "fmu/fmi3.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "config/board_gen.h"
#include "exported/exported_board.h"

#define STEP_NS ((uint64_t)BOARD_PWM_PERIOD_NS) /* a communication step is a multiple of a PWM period */
#define STEP_TOLERANCE 1e-6 /* rounding of a step size [periods] */

typedef enum { INSTANTIATED, INITIALIZATION, STEP, TERMINATED } fmu_mode_t;

typedef struct {
    exported_t *exported;
    fmu_mode_t mode;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} instance_t;

/* A state of an exported board. */
typedef struct {
    size_t size; /* [bytes] */
    uint8_t bytes[];
} state_t;

static fmi3Status report(const instance_t *fmu, fmi3Status status, const char *what, const char *where)
{
    char text[300];
    (void)snprintf(text, sizeof text, "%s: %s", where, what);
    if (fmu->log != NULL) {
        fmu->log(fmu->environment, status, (status == fmi3Discard) ? "logStatusDiscard" : "logStatusError", text);
    }
    return status;
}

static fmi3Status reported(const instance_t *fmu, exported_result_t result)
{
    if (result.status == EXPORTED_DONE) {
        return fmi3OK;
    }
    return report(fmu, (result.status == EXPORTED_REFUSED) ? fmi3Discard : fmi3Error, result.what, result.where);
}

/* ---- life ----------------------------------------------------------------------------------------------------------- */

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
    if (token == NULL || strcmp(token, exported_token()) != 0) {
        (void)report(fmu, fmi3Error, "is not that of this binary; export the FMU again", "instantiationToken");
        free(fmu);
        return NULL;
    }
    fmu->exported = exported_new();
    if (fmu->exported == NULL) {
        free(fmu);
        return NULL;
    }
    return fmu;
}

FMI3_EXPORT void fmi3FreeInstance(fmi3Instance instance);
void fmi3FreeInstance(fmi3Instance instance)
{
    instance_t *fmu = (instance_t *)instance;
    if (fmu != NULL) {
        exported_free(fmu->exported);
        free(fmu);
    }
}

FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance instance);
fmi3Status fmi3Reset(fmi3Instance instance)
{
    instance_t *fmu = (instance_t *)instance;
    exported_reset(fmu->exported);
    fmu->mode = INSTANTIATED;
    return fmi3OK;
}

/* ---- values --------------------------------------------------------------------------------------------------------- */

FMI3_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                      const fmi3Float64 values[], size_t n_values);
fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                          const fmi3Float64 values[], size_t n_values)
{
    const instance_t *fmu = (const instance_t *)instance;
    fmi3Status status = (n == n_values) ? fmi3OK : fmi3Error;
    for (size_t k = 0; k < n && status == fmi3OK; k++) {
        status = reported(fmu, exported_set(fmu->exported, references[k], values[k]));
    }
    return status;
}

FMI3_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n,
                                      fmi3Float64 values[], size_t n_values);
fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Float64 values[],
                          size_t n_values)
{
    const instance_t *fmu = (const instance_t *)instance;
    fmi3Status status = (n == n_values) ? fmi3OK : fmi3Error;
    for (size_t k = 0; k < n && status == fmi3OK; k++) {
        status = reported(fmu, exported_get(fmu->exported, references[k], &values[k]));
    }
    return status;
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
    if (fmu->mode != INSTANTIATED) {
        return report(fmu, fmi3Error, "comes after fmi3Instantiate or fmi3Reset", "fmi3EnterInitializationMode");
    }
    if (!isfinite(start)) {
        return report(fmu, fmi3Error, "is not finite", "startTime");
    }
    const fmi3Status status = reported(fmu, exported_start(fmu->exported, start));
    fmu->mode = (status == fmi3OK) ? INITIALIZATION : INSTANTIATED;
    return status;
}

FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance instance);
fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    instance_t *fmu = (instance_t *)instance;
    const board_t *board = exported_board(fmu->exported);
    const bool at_start = fmu->mode == STEP && board != NULL && board_time_ns(board) == 0; /* a state from before it */
    if (fmu->mode != INITIALIZATION && !at_start) {
        return report(fmu, fmi3Error, "comes after fmi3EnterInitializationMode", "fmi3ExitInitializationMode");
    }
    fmu->mode = STEP;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance instance);
fmi3Status fmi3Terminate(fmi3Instance instance)
{
    ((instance_t *)instance)->mode = TERMINATED;
    return fmi3OK;
}

/* The nearest number of PWM periods in a time, and how far it is [periods]. */
static double whole_periods(double seconds, double *distance)
{
    const double number = seconds / (1e-9 * (double)STEP_NS);
    const double periods = floor(number + 0.5);
    *distance = fabs(number - periods);
    return periods;
}

FMI3_EXPORT fmi3Status fmi3DoStep(fmi3Instance instance, double point, double size, fmi3Boolean no_set_state,
                                  fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, double *last);
fmi3Status fmi3DoStep(fmi3Instance instance, double point, double size, fmi3Boolean no_set_state, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, double *last)
{
    const instance_t *fmu = (const instance_t *)instance;
    board_t *board = exported_board(fmu->exported);
    double distance;
    (void)no_set_state;
    *event = *terminate = *early = false;
    *last = point;
    if (fmu->mode != STEP || board == NULL) {
        return report(fmu, fmi3Error, "the board is not initialised, or terminated", "fmi3DoStep");
    }
    const uint64_t now_ns = board_time_ns(board);
    /* The nearest period: masters add up step sizes, whose rounding grows with time. */
    if (whole_periods(point - exported_start_time(fmu->exported), &distance) * (double)STEP_NS != (double)now_ns) {
        return report(fmu, fmi3Discard, "is not the end of the last step; to go back, set a saved FMU state",
                      "currentCommunicationPoint");
    }
    const double periods = whole_periods(size, &distance);
    /* The size may be the difference of two points, each rounded. */
    const double rounding = DBL_EPSILON * (fabs(point) + size) / (1e-9 * (double)STEP_NS);
    if (!(periods >= 1.0 && periods < 1e12 && distance <= STEP_TOLERANCE * (1.0 + 1e-6 * periods) + rounding)) {
        return report(fmu, fmi3Discard, "is not a multiple of a PWM period; choose one", "communicationStepSize");
    }
    board_advance(board, now_ns + (uint64_t)periods * STEP_NS);
    if (board_error(board) != NULL) {
        return report(fmu, fmi3Error, board_error(board), "fmi3DoStep");
    }
    *last = point + size;
    return fmi3OK;
}

/* ---- state ---------------------------------------------------------------------------------------------------------- */

FMI3_EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state);
fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    (void)instance;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

/* Memory for a state; NULL: none. */
static state_t *resized(fmi3FMUState *state, size_t size)
{
    state_t *place = (state_t *)realloc(*state, sizeof *place + size);
    if (place != NULL) {
        place->size = size;
        *state = place;
    }
    return place;
}

FMI3_EXPORT fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state);
fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    const instance_t *fmu = (const instance_t *)instance;
    size_t size = 0;
    const fmi3Status status = reported(fmu, exported_save(fmu->exported, NULL, 0, &size));
    if (status != fmi3OK) {
        return status;
    }
    state_t *saved = resized(state, size);
    return (saved == NULL) ? report(fmu, fmi3Error, "no memory", "FMU state")
                           : reported(fmu, exported_save(fmu->exported, saved->bytes, size, &size));
}

FMI3_EXPORT fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state);
fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    instance_t *fmu = (instance_t *)instance;
    const state_t *saved = (const state_t *)state;
    if (saved == NULL) {
        return report(fmu, fmi3Error, "is NULL", "FMU state");
    }
    const fmi3Status status = reported(fmu, exported_restore(fmu->exported, saved->bytes, saved->size));
    if (status == fmi3OK) {
        const fmu_mode_t begun = (fmu->mode == INITIALIZATION) ? INITIALIZATION : STEP;
        fmu->mode = (exported_board(fmu->exported) != NULL) ? begun : INSTANTIATED;
    }
    return status;
}

FMI3_EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size);
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    (void)instance;
    *size = ((const state_t *)state)->size;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size);
fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    const state_t *saved = (const state_t *)state;
    if (size < saved->size) {
        return report((const instance_t *)instance, fmi3Error, "the memory is too small", "serialized FMU state");
    }
    memcpy(bytes, saved->bytes, saved->size);
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size,
                                               fmi3FMUState *state);
fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    const instance_t *fmu = (const instance_t *)instance;
    const char *problem = exported_state_problem(bytes, size);
    state_t *copy = (problem == NULL) ? resized(state, size) : NULL;
    if (copy == NULL) {
        return report(fmu, fmi3Error, (problem != NULL) ? problem : "no memory", "serialized FMU state");
    }
    memcpy(copy->bytes, bytes, size);
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
