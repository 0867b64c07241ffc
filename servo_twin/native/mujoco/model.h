/* model.h - what a model of MuJoCo says about a board: actuators, sensors, parameters. */
#ifndef MUJOCO_MODEL_H
#define MUJOCO_MODEL_H

#include <stdbool.h>

#include "config/board_gen.h"
#include "drive/axis_data.h"
#include "mujoco/drives.h"

#define PERIOD_NS ((uint64_t)BOARD_PWM_PERIOD_NS)
#define SENSORS_MAX 64
#define TEXT_MAX 1000

typedef struct {
    drive_t drive[AXES];
    uint32_t sensor[SENSORS_MAX]; /* value references */
    int sensors;
    char names[TEXT_MAX]; /* of the sensors */
    char text[TEXT_MAX]; /* why the model is refused */
} model_t;

/* What a model may set, by the name of the quantity as attribute. */
bool model_configurable(const exported_variable_t *one);

/* Read the plugin instance of a model. NULL, or what is wrong; then *where is the place in the model. */
const char *model_take(const mjModel *m, int instance, model_t *model, exported_t *board, const char **where);
const char *model_take_sensors(const mjModel *m, int instance, model_t *model, const char **where);

/* Parameters of plant and firmware, and faults, of a board that has not started. */
const char *model_configure(const mjModel *m, int instance, exported_t *board, const char **where);

/* The time step, if it is a multiple of a period. */
bool model_step(const mjModel *m, uint64_t period_ns, uint64_t *step_ns);

#endif
