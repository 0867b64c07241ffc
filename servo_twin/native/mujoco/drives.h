/* drives.h - the axes of a board as actuators: control signals become commands of the firmware. */
#ifndef MUJOCO_DRIVES_H
#define MUJOCO_DRIVES_H

#include <mujoco/mujoco.h>
#include <stdbool.h>
#include <stdint.h>

#include "config/contract_gen.h"
#include "exported/exported_board.h"

#define PLUGIN_NAME "servo.board"
#define AXES BOARD_AXES

typedef struct {
    int actuator; /* -1: none */
    bool shares; /* the other motor of the board turns the same shaft */
    control_mode_t mode;
    home_method_t home; /* after the rotor search */
    uint32_t state, substate, faults, position, enable, mode_command, set_point; /* value references */
    uint32_t pole_pairs, inertia; /* of the plant */
    uint32_t home_command, home_result, home_state;
    uint32_t tick, point_refusal; /* of the board */
} drive_t;

enum {
    PATH_NONE,
    PATH_BEGINS, /* no point has been sent */
    PATH_RUNS
};

enum {
    HOMING_WAITS, /* for the rotor */
    HOMING_RUNS,
    HOMING_ENDED
};

/* A search bears no current of another motor at its shaft: they search one after the other, and the first one is then without
 * torque until the second search has ended. */
enum {
    SEARCH_WAITS, /* for the search of the other motor */
    SEARCH_RUNS,
    SEARCH_ENDED,
    SEARCH_LEFT /* the axis has its mode */
};

/* State of a drive. */
typedef struct {
    double torque; /* for the next step: mean of the air gap in the last one, and of the holding brake [N m] */
    double zero; /* control signal minus set-point of the firmware, for angles [rad]; NaN: not in RUN/SPIN yet */
    double substate; /* in the last step; FREEWHEEL: not in RUN */
    double waited; /* in CALIB [s] */
    uint64_t faults; /* that are active */
    double offset; /* angle of the shaft minus length of the actuator, after jumps of the joint [rad] */
    uint64_t too_fast; /* 1: the joint, for the shaft */
    uint64_t refused; /* 1: the last set-point */
    uint64_t homing; /* HOMING_* */
    uint64_t search; /* SEARCH_* */
    uint64_t path; /* PATH_*: the control signal is sent as points */
    double last, before; /* control signal one point ago, and two */
} coupled_axis_t;

/* The joints whose motion is that of the motor of an actuator: its own, or those of its tendon. Angle of the motor: sum of the
 * ratios times the positions. */
int drive_joints(const mjModel *m, int actuator);
int drive_joint(const mjModel *m, int actuator, int k, double *ratio);

/* Ratio of the gearbox [1], or turns of the motor per way [rad/m]. */
double drive_gear(const mjModel *m, int actuator);

/* True if the group of an actuator is disabled. MuJoCo asks plugins for forces all the same. */
bool drive_disabled(const mjModel *m, int actuator);

/* Angle [rad] and speed [rad/s] of the motor of an actuator. */
void drive_motion(const mjModel *m, const mjData *d, int actuator, double *theta, double *omega);

/* Couple a joint anew that was moved by hand: the firmware sees nothing, the control signal is still the joint's angle. */
void drive_couple(const mjModel *m, const mjData *d, const board_t *board, const drive_t *drive, int axis,
                  coupled_axis_t *of);

/* Move the shaft with its joint. */
void drive_shaft(const mjModel *m, const mjData *d, board_t *board, const drive_t *drive, int axis, coupled_axis_t *of);

/* Inertia of all that the motor of an actuator moves, at its shaft [kg m^2]. */
double drive_inertia(const mjModel *m, mjData *d, int actuator);

/* Enable an axis, wait until its rotor is found, home it, then give it the control signal. */
void drive_command(const mjModel *m, mjData *d, exported_t *board, const drive_t drive[AXES], int axis,
                   coupled_axis_t of[AXES]);

/* Send the previous control signals as points; after a refusal the shafts are moved to their control signals first. */
void drive_follow(const mjModel *m, const mjData *d, const drive_t drive[AXES], coupled_axis_t of[AXES],
                  const exported_t *board, uint64_t step_ns);

#endif
