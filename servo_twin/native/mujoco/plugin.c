/* A board as actuators and sensors of MuJoCo: plugin `servo.board` (servo_twin/doc/coupling.md).
 *
 * MuJoCo owns the joint with its inertia, friction and stops; the board has electronics, firmware, air-gap torque and
 * holding brake. The complete board is in the plugin's state, so that every function of MuJoCo that copies a state copies
 * the board. The memory of an instance is a cache: the model, and a board that is as its last state.
 */
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "mujoco/drives.h"
#include "mujoco/finite_words.h"
#include "mujoco/model.h"

typedef struct {
    uint64_t token; /* of the export */
    coupled_axis_t axis[AXES];
    uint64_t stands; /* 1: the board could not take the last step */
    uint64_t size; /* of the board's state behind this [bytes]; 0: it starts with the next step */
} head_t;

/* The head can be written alone: the state of the board begins with a number of its own. */
#define HEAD_WORDS FINITE_WORDS(sizeof(head_t))
#define HEAD_SIZE (WORD_BYTES * HEAD_WORDS)

typedef struct instance {
    const mjData *data; /* whose instance it is */
    int number;
    struct instance *next; /* in its bucket */
    model_t model;
    exported_t *board;
    mjtNum *last; /* the plugin's state with that board */
    bool known; /* there is one */
    uint8_t *bytes; /* for a state as bytes */
    double refused[NAMES_MAX]; /* last refused value of each input, or its start, which is accepted; for the warning */
} instance_t;

/* ---- instances ------------------------------------------------------------------------------------------------------ */

/* Instances by mjData. Its plugin_data cannot be used: after unpickling it is the pointer of another mjData, or process. */
#define BUCKETS 1024u
static instance_t *buckets[BUCKETS];
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;

/* The link to an instance, or to the end of its bucket. The mutex is held. */
static instance_t **link_of(const mjData *d, int number)
{
    instance_t **link = &buckets[((uintptr_t)d >> 6) % BUCKETS];
    while (*link != NULL && ((*link)->data != d || (*link)->number != number)) {
        link = &(*link)->next;
    }
    return link;
}

static instance_t *instance_of(const mjData *d, int number)
{
    (void)pthread_mutex_lock(&mutex);
    instance_t *own = *link_of(d, number);
    (void)pthread_mutex_unlock(&mutex);
    return own;
}

/* An mjData that was freed without plugin_destroy may have left an instance at this address: it is replaced and returned. */
static instance_t *inserted(instance_t *own)
{
    (void)pthread_mutex_lock(&mutex);
    instance_t **link = link_of(own->data, own->number);
    instance_t *old = *link;
    own->next = (old != NULL) ? old->next : NULL;
    *link = own;
    (void)pthread_mutex_unlock(&mutex);
    return old;
}

static instance_t *removed(const mjData *d, int number)
{
    (void)pthread_mutex_lock(&mutex);
    instance_t **link = link_of(d, number);
    instance_t *own = *link;
    if (own != NULL) {
        *link = own->next;
    }
    (void)pthread_mutex_unlock(&mutex);
    return own;
}

/* ---- board and state ------------------------------------------------------------------------------------------------ */

/* Room for the head and a state of a board that has started. Only the compiler of models calls this. It checks the time step: later
 * it may have been changed, and the board in a copy of that simulation stands still, too. */
static int plugin_nstate(const mjModel *m, int instance)
{
    size_t size = 0;
    uint64_t step_ns;
    drive_t drive[AXES];
    exported_t *board = exported_new();
    if (board != NULL && exported_start(board, 0.0).status == EXPORTED_DONE) {
        (void)exported_save(board, NULL, 0, &size);
    }
    exported_free(board);
    model_take_modes(m, instance, drive);
    const char *problem = model_step(m, drive, &step_ns);
    if (problem != NULL) {
        mju_error(PLUGIN_NAME ": 'timestep': %s", problem);
    }
    return (int)FINITE_WORDS(HEAD_SIZE + size);
}

static mjtNum *state_of(const mjModel *m, mjData *d, int instance)
{
    return d->plugin_state + m->plugin_stateadr[instance];
}

/* Of a board that starts with the next step. */
static head_t first_head(void)
{
    head_t head = {.token = strtoull(exported_token() + 16, NULL, 16)};
    for (int axis = 0; axis < AXES; axis++) {
        head.axis[axis].zero = NAN;
    }
    return head;
}

/* False if the state is not one of this export; then the head is the first one. */
static bool head_of(const mjtNum *state, head_t *head)
{
    const head_t first = first_head();
    uint8_t bytes[HEAD_SIZE + 1];
    finite_decode(state, bytes, HEAD_WORDS);
    memcpy(head, bytes, sizeof *head);
    const bool own = head->token == first.token;
    *head = own ? *head : first;
    return own;
}

static void set_head(mjtNum *state, const head_t *head)
{
    uint8_t bytes[HEAD_SIZE + 1] = {0};
    memcpy(bytes, head, sizeof *head);
    finite_encode(state, bytes, HEAD_WORDS);
}

/* Make the board that of a state. NULL, or why it cannot be; then the board has not started. */
static const char *restore(const mjModel *m, mjData *d, int instance, head_t *head)
{
    instance_t *own = instance_of(d, instance);
    const mjtNum *state = state_of(m, d, instance);
    const size_t words = (size_t)m->plugin_statenum[instance];
    exported_result_t result = {EXPORTED_DONE};
    if (!head_of(state, head)) {
        result.what = "not one of this export";
    } else if (head->size > WORD_BYTES * words - HEAD_SIZE) {
        result.what = "too large";
    } else if (head->size > 0 && (!own->known || memcmp(own->last, state, WORD * words) != 0)) {
        finite_decode(state, own->bytes, words);
        result = exported_restore(own->board, own->bytes + HEAD_SIZE, head->size);
        memcpy(own->last, state, WORD * words);
    }
    if (result.what != NULL) {
        *head = first_head();
    }
    own->known = head->size > 0;
    if (!own->known && exported_board(own->board) != NULL) {
        const char *where;
        (void)model_configure(m, instance, own->board, &where); /* accepted at the begin */
    }
    return result.what;
}

/* Write the state after a step. NULL, or why it cannot be kept; then that of the step before stays. */
static const char *save(const mjModel *m, mjData *d, int instance, const head_t *before)
{
    instance_t *own = instance_of(d, instance);
    head_t head = *before;
    size_t size = 0;
    const size_t words = (size_t)m->plugin_statenum[instance];
    const size_t room = WORD_BYTES * words - HEAD_SIZE;
    const exported_result_t result = exported_save(own->board, own->bytes + HEAD_SIZE, room, &size);
    if (result.status != EXPORTED_DONE || size > room) { /* no host sends to it, so it does not grow */
        return (result.status != EXPORTED_DONE) ? result.what : "it has grown";
    }
    head.stands = 0;
    head.size = size;
    memset(own->bytes, 0, HEAD_SIZE);
    memcpy(own->bytes, &head, sizeof head);
    memset(own->bytes + HEAD_SIZE + size, 0, room - size);
    finite_encode(own->last, own->bytes, words);
    own->known = true;
    memcpy(state_of(m, d, instance), own->last, WORD * words);
    return NULL;
}

/* A step that the board cannot take: its state stays, without torque. Its joints have moved when it goes on, see drive_couple. */
static void stand_still(const mjModel *m, mjData *d, int instance, const char *what, const char *where)
{
    mjtNum *state = state_of(m, d, instance);
    head_t head;
    (void)head_of(state, &head);
    if (head.stands == 0) {
        mju_warning(PLUGIN_NAME ": instance %d: %s: %s; the board stands still without torque until it can go on",
                    instance, where, what);
    }
    head.stands = 1;
    for (int axis = 0; axis < AXES; axis++) {
        head.axis[axis].torque = 0.0;
    }
    set_head(state, &head);
    instance_of(d, instance)->known = false; /* the board may have taken a part of the step */
}

/* ---- life of an instance -------------------------------------------------------------------------------------------- */

static void free_instance(instance_t *own)
{
    if (own != NULL) {
        exported_free(own->board);
        free(own->last);
        free(own->bytes);
        free(own);
    }
}

static int plugin_init(const mjModel *m, mjData *d, int instance)
{
    instance_t *own = (instance_t *)calloc(1, sizeof *own);
    const char *problem = "no memory for another board";
    const char *where = "";
    if (own != NULL) {
        own->board = exported_new();
        const size_t words = (size_t)m->plugin_statenum[instance];
        own->last = (mjtNum *)malloc(WORD * words);
        own->bytes = (uint8_t *)calloc(1, finite_buffer(words));
        problem = (own->board != NULL && own->last != NULL && own->bytes != NULL)
                      ? model_take(m, instance, &own->model, own->board, &where)
                      : problem;
    }
    if (problem != NULL) {
        char text[TEXT_MAX]; /* where may point into the instance */
        (void)snprintf(text, sizeof text, "'%s': %s", where, problem);
        free_instance(own);
        mju_error(PLUGIN_NAME ": %s", text); /* the compiler of models catches it */
        return -1;
    }
    memcpy(own->refused, own->model.start, sizeof own->refused);
    own->data = d;
    own->number = instance;
    free_instance(inserted(own));
    return 0;
}

static void plugin_destroy(mjData *d, int instance) { free_instance(removed(d, instance)); }

static void plugin_reset(const mjModel *m, mjtNum *state, void *data, int instance)
{
    const head_t head = first_head();
    (void)data;
    memset(state, 0, (size_t)m->plugin_statenum[instance] * sizeof *state);
    set_head(state, &head);
}

/* ---- simulation ----------------------------------------------------------------------------------------------------- */

/* Power on; the joints are at the end of the first step, a step away from the angles of the start. */
static exported_result_t start(const mjModel *m, const mjData *d, const instance_t *own)
{
    for (int axis = 0; axis < AXES; axis++) {
        if (own->model.drive[axis].actuator >= 0) {
            char name[64];
            double theta;
            double omega;
            drive_motion(m, d, own->model.drive[axis].actuator, &theta, &omega);
            (void)snprintf(name, sizeof name, "plant.axis%d.theta_start", axis + 1);
            (void)exported_set(own->board, exported_variable(name)->reference, theta - omega * m->opt.timestep);
        }
    }
    return exported_start(own->board, d->time - m->opt.timestep);
}

/* Faults, supply and parameters that change during the run. */
static void give_inputs(const mjData *d, instance_t *own)
{
    exported_t *board = own->board;
    const model_t *model = &own->model;
    for (int i = 0; i < model->inputs.count; i++) {
        const uint32_t reference = model->inputs.variable[i]->reference;
        const double value = model->start[i] + d->userdata[model->userdata + i];
        const exported_result_t result = (value != exported_number(board, reference))
                                             ? exported_set(board, reference, value)
                                             : (exported_result_t){EXPORTED_DONE};
        if (result.status != EXPORTED_DONE && memcmp(&own->refused[i], &value, sizeof value) != 0) { /* once; or NaN */
            own->refused[i] = value;
            mju_warning(PLUGIN_NAME ": userdata %d, %s: %s", model->userdata + i, model->inputs.variable[i]->name,
                        result.what);
        }
    }
}

/* Torque of a drive for the next step, after this one [N m]. */
static double torque_of(const mjModel *m, mjData *d, board_t *board, const drive_t *drive, int axis, double impulse)
{
    board_truth_t truth;
    board_truth(board, axis, &truth);
    const double torque = (truth.impulse_e - impulse) / m->opt.timestep;
    return (truth.brake_holds != 0.0)
               ? torque + board_brake_torque(board, axis, drive_inertia(m, d, drive->actuator), m->opt.timestep)
               : torque;
}

static void plugin_advance(const mjModel *m, mjData *d, int instance)
{
    instance_t *own = instance_of(d, instance);
    double impulse[AXES] = {0.0};
    uint64_t step_ns;
    head_t head;
    const char *problem = model_step(m, own->model.drive, &step_ns);
    if (problem != NULL) {
        stand_still(m, d, instance, problem, "timestep");
        return;
    }
    problem = restore(m, d, instance, &head);
    if (problem != NULL) {
        mju_warning(PLUGIN_NAME ": instance %d: plugin state: %s; the board starts anew", instance, problem);
    }
    const exported_result_t started = (head.size == 0) ? start(m, d, own) : (exported_result_t){EXPORTED_DONE};
    if (started.status != EXPORTED_DONE) {
        stand_still(m, d, instance, started.what, started.where);
        return;
    }
    board_t *board = exported_board(own->board);
    give_inputs(d, own);
    for (int axis = 0; axis < AXES; axis++) { /* before all that use the zero of the control signal */
        if (own->model.drive[axis].actuator >= 0) {
            drive_couple(m, d, board, &own->model.drive[axis], axis, &head.axis[axis]);
        }
    }
    drive_follow(m, d, own->model.drive, head.axis, own->board, step_ns); /* before: the mode of a path takes a step */
    for (int axis = 0; axis < AXES; axis++) {
        const drive_t *drive = &own->model.drive[axis];
        if (drive->actuator >= 0) {
            board_truth_t truth;
            drive_command(m, d, own->board, own->model.drive, axis, head.axis);
            drive_shaft(m, d, board, drive, axis, &head.axis[axis]);
            board_truth(board, axis, &truth);
            impulse[axis] = truth.impulse_e;
        }
    }
    board_advance(board, board_time_ns(board) + step_ns);
    if (board_error(board) != NULL) {
        stand_still(m, d, instance, board_error(board), "board");
        return;
    }
    for (int axis = 0; axis < AXES; axis++) {
        const drive_t *drive = &own->model.drive[axis];
        if (drive->actuator >= 0) {
            head.axis[axis].torque = torque_of(m, d, board, drive, axis, impulse[axis]);
        }
    }
    problem = save(m, d, instance, &head);
    if (problem != NULL) {
        stand_still(m, d, instance, problem, "plugin state");
    }
}

static void plugin_compute(const mjModel *m, mjData *d, int instance, int capability)
{
    const instance_t *own = instance_of(d, instance);
    head_t head;
    if (capability == mjPLUGIN_ACTUATOR) {
        (void)head_of(state_of(m, d, instance), &head);
        for (int axis = 0; axis < AXES; axis++) {
            const int actuator = own->model.drive[axis].actuator;
            if (actuator >= 0) {
                d->actuator_force[m->actuator_outadr[actuator]] =
                    drive_disabled(m, actuator) ? 0.0 : head.axis[axis].torque;
            }
        }
        return;
    }
    (void)restore(m, d, instance, &head); /* the next step warns */
    for (int k = 0; k < (int)m->nsensor; k++) {
        for (int i = 0; m->sensor_plugin[k] == instance && i < own->model.sensors.count; i++) {
            d->sensordata[m->sensor_adr[k] + i] =
                exported_number(own->board, own->model.sensors.variable[i]->reference);
        }
    }
}

static int plugin_nsensordata(const mjModel *m, int instance, int sensor)
{
    names_t sensors;
    const char *where;
    (void)sensor;
    return (model_take_sensors(m, instance, &sensors, &where) == NULL) ? sensors.count : 0;
}

mjPLUGIN_LIB_INIT(servo_board)
{
    static const char *attributes[4 * EXPORTED_BLOCK] = {"axis1",   "axis2",  "axis1.home", "axis2.home", "shaft",
                                                         "sensors", "inputs", "userdata",   "level"};
    size_t n;
    const exported_variable_t *variables = exported_variables(&n);
    int count = 9;
    for (size_t k = 0; k < n; k++) {
        if (model_configurable(&variables[k])) {
            attributes[count++] = variables[k].name;
        }
    }
    mjpPlugin plugin;
    mjp_defaultPlugin(&plugin);
    plugin.name = PLUGIN_NAME;
    plugin.nattribute = count;
    plugin.attributes = attributes;
    plugin.capabilityflags = mjPLUGIN_ACTUATOR | mjPLUGIN_SENSOR;
    plugin.needstage = mjSTAGE_ACC;
    plugin.nstate = plugin_nstate;
    plugin.nsensordata = plugin_nsensordata;
    plugin.init = plugin_init;
    plugin.destroy = plugin_destroy;
    plugin.reset = plugin_reset;
    plugin.compute = plugin_compute;
    plugin.advance = plugin_advance;
    (void)mjp_registerPlugin(&plugin);
}
