#include "mujoco/model.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define TICK_NS (PERIOD_NS * AXIS_SLOW_PERIODS)
#define INERTIA_TOLERANCE 0.01
#define TIME_TOLERANCE 1e-3 /* of a time step [ns] */

static const char *const mode_names[] = {[CONTROL_MODE_POSITION] = "POSITION",
                                         [CONTROL_MODE_SPEED] = "SPEED",
                                         [CONTROL_MODE_TORQUE] = "TORQUE",
                                         [CONTROL_MODE_TRAJECTORY] = "TRAJECTORY"};
static const char *const set_points[] = {[CONTROL_MODE_POSITION] = "cmd.position",
                                         [CONTROL_MODE_SPEED] = "cmd.speed",
                                         [CONTROL_MODE_TORQUE] = "cmd.i_q",
                                         [CONTROL_MODE_TRAJECTORY] = "cmd.position"};

static const char *const method_names[] = {
    [HOME_METHOD_HERE] = "HERE",
    [HOME_METHOD_ASSUME] = "ASSUME",
    [HOME_METHOD_STOP_POSITIVE] = "STOP_POSITIVE",
    [HOME_METHOD_STOP_NEGATIVE] = "STOP_NEGATIVE",
    [HOME_METHOD_SWITCH_POSITIVE] = "SWITCH_POSITIVE",
    [HOME_METHOD_SWITCH_NEGATIVE] = "SWITCH_NEGATIVE",
};

#define METHODS (sizeof method_names / sizeof method_names[0])
#define MODES (sizeof mode_names / sizeof mode_names[0])

/* Value reference of a quantity of an axis that every board has. */
static uint32_t of_axis(int axis, const char *name)
{
    char text[64];
    (void)snprintf(text, sizeof text, "axis%d.%s", axis + 1, name);
    return exported_variable(text)->reference;
}

/* The same of its parameter in the plant. */
static uint32_t of_plant(int axis, const char *name)
{
    char text[64];
    (void)snprintf(text, sizeof text, "plant.axis%d.%s", axis + 1, name);
    return exported_variable(text)->reference;
}

/* Not the commands, which the plugin gives, nor load and lock of a shaft that MuJoCo moves. */
bool model_configurable(const exported_variable_t *one)
{
    return one->writable && strstr(one->name, ".cmd.") == NULL && strstr(one->name, ".torque") == NULL &&
           strstr(one->name, ".locked") == NULL && strcmp(one->name, "param.command_timeout") != 0;
}

static const char *config(const mjModel *m, int instance, const char *name)
{
    const char *text = mj_getPluginConfig(m, instance, name);
    return (text != NULL) ? text : "";
}

/* True if two actuators turn the same joint, or pull the same tendon. */
static bool same_target(const mjModel *m, int one, int other)
{
    return (m->actuator_trntype[one] == mjTRN_TENDON) == (m->actuator_trntype[other] == mjTRN_TENDON) &&
           m->actuator_trnid[2 * one] == m->actuator_trnid[2 * other];
}

/* True if an equality constraint ties the joints, or the tendons, of two actuators. */
static bool tied(const mjModel *m, int one, int other)
{
    const bool tendon = m->actuator_trntype[one] == mjTRN_TENDON;
    const int a = m->actuator_trnid[2 * one];
    const int b = m->actuator_trnid[2 * other];
    bool found = false;
    for (int k = 0; k < (int)m->neq; k++) {
        const int first = m->eq_obj1id[k];
        const int second = m->eq_obj2id[k];
        found |= m->eq_type[k] == (tendon ? mjEQ_TENDON : mjEQ_JOINT) &&
                 ((first == a && second == b) || (first == b && second == a));
    }
    return found && tendon == (m->actuator_trntype[other] == mjTRN_TENDON);
}

/* A shaft without friction does not stay at rest for the second search: the first motor has an offset of torque. */
static bool has_friction(const mjModel *m, int actuator)
{
    const int target = m->actuator_trnid[2 * actuator];
    bool found = m->actuator_trntype[actuator] == mjTRN_TENDON && m->tendon_frictionloss[target] > 0.0;
    for (int k = 0; k < drive_joints(m, actuator); k++) {
        double ratio;
        found |= m->dof_frictionloss[m->jnt_dofadr[drive_joint(m, actuator, k, &ratio)]] > 0.0;
    }
    return found;
}

/* Whether the motors of one shaft search one after the other. NULL, or what is wrong. */
static const char *take_shaft(const mjModel *m, int instance, drive_t drive[AXES], const char **where)
{
    const int one = drive[0].actuator;
    const int other = drive[1].actuator;
    const char *text = config(m, instance, "shaft");
    const bool shared = strcmp(text, "SHARED") == 0;
    *where = "shaft";
    if (text[0] != '\0' && (!shared || one < 0 || other < 0)) {
        return shared ? "a board with one actuator shares no shaft" : "write SHARED if both motors turn one shaft";
    }
    drive[0].shares = one >= 0 && other >= 0 &&
                      (shared || (has_friction(m, one) && (same_target(m, one, other) || tied(m, one, other))));
    drive[1].shares = drive[0].shares;
    return NULL;
}

/* True if a board that this one does not know of is at the joint of an actuator. */
static bool another_board(const mjModel *m, int instance, int actuator)
{
    for (int k = 0; k < (int)m->nactuator; k++) {
        const int other = m->actuator_plugin[k];
        if (other >= 0 && other != instance && m->plugin[other] == m->plugin[instance] && same_target(m, k, actuator)) {
            return true;
        }
    }
    return false;
}

/* True for a hinge or a slide, or a tendon of such joints: lengths that are linear in the positions. */
static bool is_linear(const mjModel *m, int actuator)
{
    const int type = m->actuator_trntype[actuator];
    const int target = m->actuator_trnid[2 * actuator];
    if (type == mjTRN_TENDON) {
        return m->wrap_type[m->tendon_adr[target]] == mjWRAP_JOINT; /* then all are */
    }
    return (type == mjTRN_JOINT || type == mjTRN_JOINTINPARENT) &&
           (m->jnt_type[target] == mjJNT_HINGE || m->jnt_type[target] == mjJNT_SLIDE);
}

static const char *refuse_drive(const mjModel *m, int instance, int actuator)
{
    if (actuator < 0 || m->actuator_plugin[actuator] != instance) {
        return "no actuator of this plugin instance has this name";
    }
    if (!is_linear(m, actuator)) {
        return "a motor turns a hinge or a slide, or pulls a fixed tendon; write joint=... or tendon=... of one of them";
    }
    if (m->actuator_dyntype[actuator] != mjDYN_NONE || m->actuator_actnum[actuator] > 0) {
        return "the actuator has an activation, but the firmware takes ctrl; remove dyntype and actdim";
    }
    const double gear = drive_gear(m, actuator);
    if (gear == 0.0 || !isfinite(gear)) {
        return "the gear is 0 or no number; write the ratio of the gearbox, for example gear=\"100\"";
    }
    return another_board(m, instance, actuator) ? "another board drives its joint; use the two axes of one board"
                                                : NULL;
}

static const char *const axis_keys[AXES] = {"axis1", "axis2"};

/* Split "ACTUATOR [MODE]", which is POSITION by default. */
static control_mode_t take_mode(char name[TEXT_MAX], const char *text)
{
    (void)snprintf(name, TEXT_MAX, "%s", text);
    char *space = strrchr(name, ' ');
    for (size_t k = 0; space != NULL && k < MODES; k++) {
        if (strcmp(space + 1, mode_names[k]) == 0) {
            *space = '\0';
            return (control_mode_t)k;
        }
    }
    return CONTROL_MODE_POSITION;
}

void model_take_modes(const mjModel *m, int instance, drive_t drive[AXES])
{
    char name[TEXT_MAX];
    for (int axis = 0; axis < AXES; axis++) {
        drive[axis].mode = take_mode(name, config(m, instance, axis_keys[axis]));
    }
}

/* An actuator of an instance by its name, or by the end of it: a model that is attached to another one gets a prefix. -1: none. */
static int named_actuator(const mjModel *m, int instance, const char *name)
{
    int found = mj_name2id(m, mjOBJ_ACTUATOR, name);
    for (int k = 0; k < (int)m->nactuator && (found < 0 || m->actuator_plugin[found] != instance); k++) {
        const char *own = m->names + m->name_actuatoradr[k];
        const size_t more = (strlen(own) > strlen(name)) ? strlen(own) - strlen(name) : 0;
        found = (m->actuator_plugin[k] == instance && strcmp(own + more, name) == 0) ? k : found;
    }
    return found;
}

/* "ACTUATOR [MODE]" of an axis. NULL, or what is wrong. */
static const char *take_drive(const mjModel *m, int instance, drive_t *drive, const char *text)
{
    char name[TEXT_MAX];
    drive->mode = take_mode(name, text);
    drive->actuator = named_actuator(m, instance, name);
    return (drive->actuator < 0)
               ? "no actuator has this name; write \"ACTUATOR [POSITION | SPEED | TORQUE | TRAJECTORY]\""
               : refuse_drive(m, instance, drive->actuator);
}

/* Homing of an axis after its rotor search. */
static const char *take_home(const mjModel *m, int instance, drive_t *drive, const char *key, const char **where)
{
    const char *text = config(m, instance, key);
    drive->home = HOME_METHOD_NONE;
    for (size_t k = 0; k < METHODS; k++) {
        if (method_names[k] != NULL && strcmp(text, method_names[k]) == 0) {
            drive->home = (home_method_t)k;
        }
    }
    *where = key;
    if (text[0] == '\0') {
        return NULL;
    }
    if (drive->home == HOME_METHOD_NONE) {
        return "no method of homing; write HERE, ASSUME, STOP_POSITIVE, STOP_NEGATIVE, SWITCH_POSITIVE or SWITCH_NEGATIVE";
    }
    return (drive->actuator < 0) ? "the axis has no actuator" : NULL;
}

/* Axes of the actuators: by the attributes axis1 and axis2, without them in the order of the model. */
static const char *take_drives(const mjModel *m, int instance, model_t *model, const char **where)
{
    int count = 0;
    bool named = false;
    for (int axis = 0; axis < AXES; axis++) {
        model->drive[axis].actuator = -1;
        const char *text = config(m, instance, axis_keys[axis]);
        if (text[0] != '\0') {
            named = true;
            *where = axis_keys[axis];
            const char *problem = take_drive(m, instance, &model->drive[axis], text);
            if (problem != NULL) {
                return problem;
            }
        }
    }
    for (int k = 0; k < (int)m->nactuator; k++) {
        if (m->actuator_plugin[k] != instance) {
            continue;
        }
        *where = "actuator";
        if (!named && count < AXES) {
            model->drive[count].actuator = k;
            const char *problem = refuse_drive(m, instance, k);
            if (problem != NULL) {
                return problem;
            }
        } else if (count >= AXES || (model->drive[0].actuator != k && model->drive[1].actuator != k)) {
            return "a board has two axes; name its actuators by axis1 and axis2, or use another instance";
        }
        count++;
    }
    *where = "actuator";
    return (model->drive[0].actuator == model->drive[1].actuator) ? "two axes have one actuator, or none has one"
                                                                  : NULL;
}

/* NULL, or what is wrong with a name that is then at *where. */
static const char *take_names(const char *text, names_t *names, const char **where)
{
    static const char blanks[] = " \t\r\n";
    names->count = 0;
    if (strlen(text) >= sizeof names->text) {
        return "the list of quantities is too long";
    }
    memcpy(names->text, text, strlen(text) + 1u);
    char *name = names->text + strspn(names->text, blanks);
    while (*name != '\0') {
        char *end = name + strcspn(name, blanks);
        char *next = end + strspn(end, blanks);
        *end = '\0';
        const exported_variable_t *one = exported_variable(name);
        *where = name;
        if (one == NULL || names->count == NAMES_MAX) {
            return (one == NULL) ? "the board has no such quantity" : "more than 64 quantities";
        }
        names->variable[names->count++] = one;
        name = next;
    }
    return NULL;
}

const char *model_take_sensors(const mjModel *m, int instance, names_t *sensors, const char **where)
{
    return take_names(config(m, instance, "sensors"), sensors, where);
}

/* Index of an instance's first entry of mjData.userdata; -1: it is none. */
static long first_of(const mjModel *m, int instance)
{
    const char *text = config(m, instance, "userdata");
    char *end;
    const long index = strtol(text, &end, 10);
    return (*end == '\0' && index >= 0 && index <= INT32_MAX) ? index : -1;
}

/* Number of the inputs of another instance, and its first entry of mjData.userdata. 0: none, or what it refuses itself. */
static int other_inputs(const mjModel *m, int instance, int other, long *first)
{
    names_t names;
    const char *where;
    *first = first_of(m, other);
    const bool is = other != instance && m->plugin[other] == m->plugin[instance] && *first >= 0 &&
                    take_names(config(m, other, "inputs"), &names, &where) == NULL;
    return is ? names.count : 0;
}

/* Two boards with one entry of mjData.userdata would change together. NULL, or which instance has an entry already. */
static const char *refuse_shared(const mjModel *m, int instance, model_t *model)
{
    const long first = model->userdata;
    const long end = first + model->inputs.count;
    int shares = -1;
    long unused = 0; /* the first entry behind those of all others */
    long other;
    for (int k = 0; k < m->nplugin; k++) {
        const int count = other_inputs(m, instance, k, &other);
        shares = (count > 0 && other < end && first < other + count) ? k : shares;
        unused = (count > 0 && other + count > unused) ? other + count : unused;
    }
    if (shares < 0) {
        return NULL;
    }
    const int count = other_inputs(m, instance, shares, &other);
    const char *name = mj_id2name(m, mjOBJ_PLUGIN, shares);
    (void)snprintf(model->text, sizeof model->text,
                   "the inputs are entries %ld .. %ld of mjData.userdata, those of instance '%s' %ld .. %ld; "
                   "write <config key=\"userdata\" value=\"%ld\"/> and <size nuserdata=\"%ld\"/>",
                   first, end - 1, (name != NULL) ? name : "", other, other + count - 1, unused,
                   unused + model->inputs.count);
    return model->text;
}

/* Quantities that change during the run. */
static const char *take_inputs(const mjModel *m, int instance, model_t *model, const exported_t *board,
                               const char **where)
{
    const char *problem = take_names(config(m, instance, "inputs"), &model->inputs, where);
    const long index = first_of(m, instance);
    if (problem == NULL && index < 0) {
        *where = "userdata";
        return "not the index of an entry of mjData.userdata";
    }
    model->userdata = (int)index;
    for (int i = 0; problem == NULL && i < model->inputs.count; i++) {
        const exported_variable_t *one = model->inputs.variable[i];
        *where = one->name;
        if (!model_configurable(one) || one->reference >= EXPORTED_PLANT * EXPORTED_BLOCK) {
            return "inputs: does not change during the run";
        }
        if (index + i >= m->nuserdata) {
            *where = "inputs";
            (void)snprintf(model->text, sizeof model->text,
                           "mjData.userdata is too short; write <size nuserdata=\"%ld\"/>",
                           index + model->inputs.count);
            return model->text;
        }
        model->start[i] = exported_number(board, one->reference);
    }
    if (problem == NULL && model->inputs.count > 0) {
        *where = "inputs";
        problem = refuse_shared(m, instance, model);
    }
    return problem;
}

const char *model_configure(const mjModel *m, int instance, exported_t *board, const char **where)
{
    size_t n;
    const exported_variable_t *variables = exported_variables(&n);
    exported_reset(board);
    for (size_t k = 0; k < n; k++) {
        const char *text = model_configurable(&variables[k]) ? config(m, instance, variables[k].name) : "";
        if (text[0] != '\0') {
            char *end;
            const double value = strtod(text, &end);
            *where = variables[k].name;
            if (*end != '\0') {
                return "not a number";
            }
            const exported_result_t result = exported_set(board, variables[k].reference, value);
            if (result.status != EXPORTED_DONE) {
                return result.what;
            }
        }
    }
    return NULL;
}

/* The devices at the pins of an axis that the firmware needs, or that need the firmware. */
static const char *check_pins(const model_t *model, const exported_t *board, int axis)
{
    const drive_t *drive = &model->drive[axis];
    const unsigned pins = board_pins(exported_board(board), axis);
    const bool to_switch = drive->home == HOME_METHOD_SWITCH_POSITIVE || drive->home == HOME_METHOD_SWITCH_NEGATIVE;
    if (to_switch && (pins & (1u << BOARD_PIN_HOME)) == 0u) {
        return "homing to a switch, but the firmware has none; write home = true in [axisN.pins] of a servo.toml and export "
               "the plugin with --config";
    }
    if (to_switch &&
        exported_number(board, of_plant(axis, "home_from")) > exported_number(board, of_plant(axis, "home_to"))) {
        return "homing to a switch, but the plant has none; write its angles plant.axisN.home_from and .home_to";
    }
    if (exported_number(board, of_plant(axis, "brake_torque")) > 0.0 && (pins & (1u << BOARD_PIN_BRAKE)) == 0u) {
        return "the plant has a holding brake that the firmware does not open; write brake = true in [axisN.pins] of a "
               "servo.toml and export the plugin with --config, or set brake_torque to 0";
    }
    return NULL;
}

/* The rotors of the axes at the joint of an actuator are in its inertia. */
static const char *check_joint(const mjModel *m, model_t *model, const exported_t *board, int axis)
{
    const int at = model->drive[axis].actuator;
    const int target = m->actuator_trnid[2 * at];
    const bool tendon = m->actuator_trntype[at] == mjTRN_TENDON;
    double least = 0.0;
    double armature = tendon ? m->tendon_armature[target] : m->dof_armature[m->jnt_dofadr[target]];
    for (int k = 0; k < AXES; k++) {
        const int actuator = model->drive[k].actuator;
        if (actuator >= 0 && same_target(m, actuator, at)) {
            const double gear = drive_gear(m, actuator);
            least += gear * gear * exported_number(board, of_plant(k, "inertia"));
            armature += gear * gear * m->actuator_armature[actuator];
        }
    }
    if (armature < (1.0 - INERTIA_TOLERANCE) * least) {
        (void)snprintf(model->text, sizeof model->text,
                       "the %s has less than the inertia of its rotors; write armature=\"%g\"",
                       tendon ? "tendon" : "joint", least);
        return model->text;
    }
    return (exported_number(board, of_plant(axis, "load_inertia")) > 0.0)
               ? "the axis has a second mass, but MuJoCo owns all inertia; set load_inertia to 0"
               : NULL;
}

const char *model_step(const mjModel *m, const drive_t drive[AXES], uint64_t *step_ns)
{
    const double step = m->opt.timestep * 1e9;
    *step_ns = (step > 0.5 && step < 1e12) ? (uint64_t)(step + 0.5) : 0;
    if (*step_ns < PERIOD_NS || *step_ns % PERIOD_NS != 0 || !(fabs(step - (double)*step_ns) < TIME_TOLERANCE)) {
        return "not a multiple of a PWM period; write for example <option timestep=\"0.0005\"/>";
    }
    for (int axis = 0; axis < AXES; axis++) {
        if (drive[axis].mode == CONTROL_MODE_TRAJECTORY && *step_ns % TICK_NS != 0) {
            return "in mode TRAJECTORY a multiple of a slow tick; write for example <option timestep=\"0.0005\"/>";
        }
    }
    return NULL;
}

const char *model_take(const mjModel *m, int instance, model_t *model, exported_t *board, const char **where)
{
    const char *level = config(m, instance, "level");
    *where = "level";
    if (level[0] != '\0' && strcmp(level, "ideal") != 0) {
        return "the plugin has a board at level ideal; for level registers use servo-sim robot or RobotDrives";
    }
    const char *problem = take_drives(m, instance, model, where);
    for (int axis = 0; problem == NULL && axis < AXES; axis++) {
        static const char *const keys[AXES] = {"axis1.home", "axis2.home"};
        problem = take_home(m, instance, &model->drive[axis], keys[axis], where);
    }
    problem = (problem == NULL) ? take_shaft(m, instance, model->drive, where) : problem;
    problem = (problem == NULL) ? model_take_sensors(m, instance, &model->sensors, where) : problem;
    problem = (problem == NULL) ? model_configure(m, instance, board, where) : problem;
    problem = (problem == NULL) ? take_inputs(m, instance, model, board, where) : problem;
    if (problem == NULL) { /* for the pins of the firmware; the first step configures it anew */
        const exported_result_t started = exported_start(board, 0.0);
        problem = (started.status == EXPORTED_DONE) ? NULL : started.what;
        *where = (problem == NULL) ? *where : started.where;
    }
    for (int axis = 0; axis < AXES; axis++) {
        drive_t *drive = &model->drive[axis];
        if (problem == NULL && drive->actuator >= 0) {
            *where = m->names + m->name_actuatoradr[drive->actuator];
            problem = check_joint(m, model, board, axis);
            problem = (problem == NULL) ? check_pins(model, board, axis) : problem;
        }
        drive->state = of_axis(axis, "state");
        drive->substate = of_axis(axis, "substate");
        drive->faults = of_axis(axis, "faults");
        drive->position = of_axis(axis, "position");
        drive->enable = of_axis(axis, "cmd.enable");
        drive->mode_command = of_axis(axis, "cmd.mode");
        drive->home_command = of_axis(axis, "cmd.home");
        drive->home_result = of_axis(axis, "home_result");
        drive->home_state = of_axis(axis, "home_state");
        drive->set_point = of_axis(axis, set_points[drive->mode]);
        drive->pole_pairs = of_plant(axis, "pole_pairs");
        drive->inertia = of_plant(axis, "inertia");
        drive->tick = exported_variable("tick")->reference;
        drive->point_refusal = exported_variable("point_refusal")->reference;
    }
    return problem;
}
