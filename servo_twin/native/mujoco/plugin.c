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
    coupled_axis_t axis[AXES];
    uint64_t size; /* of the board's state behind this [bytes]; 0: it starts with the next step */
} head_t;

typedef struct instance {
    const mjData *data; /* whose instance it is */
    int number;
    struct instance *next; /* in its bucket */
    model_t model;
    exported_t *board;
    mjtNum *last; /* the plugin's state with that board */
    bool known; /* there is one */
    uint8_t *bytes; /* for a state as bytes */
    double refused[NAMES_MAX]; /* last refused value of each input, for the warning */
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

/* Room for the head and a state of a board that has started. */
static int plugin_nstate(const mjModel *m, int instance)
{
    size_t size = 0;
    (void)m;
    (void)instance;
    exported_t *board = exported_new();
    if (board != NULL && exported_start(board, 0.0).status == EXPORTED_DONE) {
        (void)exported_save(board, NULL, 0, &size);
    }
    exported_free(board);
    return (int)finite_words(sizeof(head_t) + size);
}

static mjtNum *state_of(const mjModel *m, mjData *d, int instance)
{
    return d->plugin_state + m->plugin_stateadr[instance];
}

static head_t head_of(const mjtNum *state)
{
    head_t head;
    uint8_t bytes[sizeof head + WORD];
    finite_decode(state, bytes, finite_words(sizeof head));
    memcpy(&head, bytes, sizeof head);
    return head;
}

/* The board as it is in a state. */
static exported_t *restored(const mjModel *m, mjData *d, int instance)
{
    instance_t *own = instance_of(d, instance);
    const mjtNum *state = state_of(m, d, instance);
    const size_t words = (size_t)m->plugin_statenum[instance];
    const size_t room = WORD_BYTES * words - sizeof(head_t);
    const head_t head = head_of(state);
    if (head.size == 0) {
        if (exported_board(own->board) != NULL) {
            const char *where;
            (void)model_configure(m, instance, own->board, &where); /* accepted at the begin */
        }
        own->known = false;
    } else if (!own->known || memcmp(own->last, state, WORD * words) != 0) {
        finite_decode(state, own->bytes, words);
        const exported_result_t result = (head.size <= room)
                                             ? exported_restore(own->board, own->bytes + sizeof head, head.size)
                                             : (exported_result_t){EXPORTED_FAILED, "is too large", "state"};
        own->known = result.status == EXPORTED_DONE;
        if (!own->known) {
            mju_error(PLUGIN_NAME ": plugin state: %s", result.what);
        }
        memcpy(own->last, state, WORD * words);
    }
    return own->board;
}

static void save(const mjModel *m, mjData *d, int instance, head_t head)
{
    instance_t *own = instance_of(d, instance);
    size_t size = 0;
    const size_t words = (size_t)m->plugin_statenum[instance];
    const size_t room = WORD_BYTES * words - sizeof head;
    const exported_result_t result = exported_save(own->board, own->bytes + sizeof head, room, &size);
    if (result.status != EXPORTED_DONE || size > room) {
        mju_error(PLUGIN_NAME ": %s",
                  (result.status != EXPORTED_DONE) ? result.what : "the state of the board has grown");
    }
    head.size = size;
    memcpy(own->bytes, &head, sizeof head);
    memset(own->bytes + sizeof head + size, 0, room - size);
    finite_encode(own->last, own->bytes, words);
    own->known = true;
    memcpy(state_of(m, d, instance), own->last, WORD * words);
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
    own->data = d;
    own->number = instance;
    free_instance(inserted(own));
    return 0;
}

static void plugin_destroy(mjData *d, int instance) { free_instance(removed(d, instance)); }

static void plugin_reset(const mjModel *m, mjtNum *state, void *data, int instance)
{
    head_t head = {.size = 0};
    (void)data;
    for (int axis = 0; axis < AXES; axis++) {
        head.axis[axis].zero = NAN;
    }
    uint8_t bytes[sizeof head + WORD] = {0};
    memcpy(bytes, &head, sizeof head);
    memset(state, 0, (size_t)m->plugin_statenum[instance] * sizeof *state);
    finite_encode(state, bytes, finite_words(sizeof head));
}

/* ---- simulation ----------------------------------------------------------------------------------------------------- */

/* Power on; the joints are at the end of the first step, a step away from the angles of the start. */
static void start(const mjModel *m, const mjData *d, int instance, const instance_t *own)
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
    const exported_result_t result = exported_start(own->board, d->time - m->opt.timestep);
    if (result.status != EXPORTED_DONE) {
        mju_error(PLUGIN_NAME ": instance %d: %s: %s", instance, result.where, result.what);
    }
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
        if (result.status != EXPORTED_DONE && own->refused[i] != value) { /* once, not in every step */
            own->refused[i] = value;
            mju_warning(PLUGIN_NAME ": userdata %d, %s: %s", model->userdata + i, model->inputs.variable[i]->name,
                        result.what);
        }
    }
}

static void plugin_advance(const mjModel *m, mjData *d, int instance)
{
    instance_t *own = instance_of(d, instance);
    exported_t *exported = restored(m, d, instance);
    head_t head = head_of(state_of(m, d, instance));
    double before[AXES] = {0.0};
    board_truth_t truth;
    uint64_t step_ns;
    if (!model_step(m, PERIOD_NS, &step_ns)) {
        mju_error(PLUGIN_NAME ": the time step of the model is not a multiple of a PWM period any more");
    }
    if (head.size == 0) {
        start(m, d, instance, own);
    }
    board_t *board = exported_board(exported);
    give_inputs(d, own);
    for (int axis = 0; axis < AXES; axis++) { /* before all that use the zero of the control signal */
        if (own->model.drive[axis].actuator >= 0) {
            drive_couple(m, d, board, &own->model.drive[axis], axis, &head.axis[axis]);
        }
    }
    drive_follow(m, d, own->model.drive, head.axis, exported, step_ns); /* before: the mode of a path takes a step */
    for (int axis = 0; axis < AXES; axis++) {
        const drive_t *drive = &own->model.drive[axis];
        if (drive->actuator >= 0) {
            drive_command(m, d, exported, drive, axis, &head.axis[axis]);
            drive_shaft(m, d, board, drive, axis, &head.axis[axis]);
            board_truth(board, axis, &truth);
            before[axis] = truth.impulse_e;
        }
    }
    board_advance(board, board_time_ns(board) + step_ns);
    if (board_error(board) != NULL) {
        own->known = false; /* the same state is restored again */
        mju_error(PLUGIN_NAME ": instance %d: %s", instance, board_error(board));
    }
    for (int axis = 0; axis < AXES; axis++) {
        board_truth(board, axis, &truth);
        head.axis[axis].torque = (truth.impulse_e - before[axis]) / m->opt.timestep;
        if (truth.brake_holds != 0.0 && own->model.drive[axis].actuator >= 0) {
            head.axis[axis].torque +=
                board_brake_torque(board, axis, drive_inertia(m, d, own->model.drive[axis].actuator), m->opt.timestep);
        }
    }
    save(m, d, instance, head);
}

static void plugin_compute(const mjModel *m, mjData *d, int instance, int capability)
{
    const instance_t *own = instance_of(d, instance);
    if (capability == mjPLUGIN_ACTUATOR) {
        const head_t head = head_of(state_of(m, d, instance));
        for (int axis = 0; axis < AXES; axis++) {
            if (own->model.drive[axis].actuator >= 0) {
                d->actuator_force[own->model.drive[axis].actuator] = head.axis[axis].torque;
            }
        }
        return;
    }
    const exported_t *board = restored(m, d, instance);
    for (int k = 0; k < (int)m->nsensor; k++) {
        for (int i = 0; m->sensor_plugin[k] == instance && i < own->model.sensors.count; i++) {
            d->sensordata[m->sensor_adr[k] + i] = exported_number(board, own->model.sensors.variable[i]->reference);
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
    static const char *attributes[4 * EXPORTED_BLOCK] = {"axis1",   "axis2",  "axis1.home", "axis2.home",
                                                         "sensors", "inputs", "userdata",   "level"};
    size_t n;
    const exported_variable_t *variables = exported_variables(&n);
    int count = 8;
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
