/* model.h - what a model of MuJoCo says about a board: actuators, sensors, parameters. */
#ifndef MUJOCO_MODEL_H
#define MUJOCO_MODEL_H

#include <stdbool.h>

#include "config/board_gen.h"
#include "drive/axis_data.h"
#include "mujoco/drives.h"

#define PERIOD_NS ((uint64_t)BOARD_PWM_PERIOD_NS)
#define NAMES_MAX 64 /* of sensors, and of inputs */
#define TEXT_MAX 1000

/* Names of quantities, separated by blanks. */
typedef struct {
    char text[TEXT_MAX];
    const exported_variable_t *variable[NAMES_MAX];
    int count;
} names_t;

typedef struct {
    drive_t drive[AXES];
    names_t sensors;
    names_t inputs; /* their values are start plus an entry of mjData.userdata, so that 0 is no change */
    double start[NAMES_MAX]; /* of the inputs */
    int userdata; /* index of the first input */
    char text[TEXT_MAX]; /* why the model is refused */
} model_t;

/* What a model may set, by the name of the quantity as attribute. */
bool model_configurable(const exported_variable_t *one);

/* Read the plugin instance of a model. NULL, or what is wrong; then *where is the place in the model. */
const char *model_take(const mjModel *m, int instance, model_t *model, exported_t *board, const char **where);
const char *model_take_sensors(const mjModel *m, int instance, names_t *sensors, const char **where);

/* Parameters of plant and firmware, and faults, of a board that has not started. */
const char *model_configure(const mjModel *m, int instance, exported_t *board, const char **where);

/* The modes alone, before the actuators of a model are complete. */
void model_take_modes(const mjModel *m, int instance, drive_t drive[AXES]);

/* The time step of a model, for drives with these modes. NULL, or what is wrong; users change it during the run. */
const char *model_step(const mjModel *m, const drive_t drive[AXES], uint64_t *step_ns);

#endif
