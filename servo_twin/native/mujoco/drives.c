#include "mujoco/drives.h"

#include <math.h>

#include "config/board_gen.h"

#define PERIOD_NS ((uint64_t)BOARD_PWM_PERIOD_NS)
#define POINT_NS UINT64_C(2000000) /* shortest time between two points of a path */
/* From the arrival of a point until its predecessor is reached; the board needs 1.5 ms. */
#define AHEAD_NS UINT64_C(2000000)
#define ARRIVED 0.01 /* [rad] */
#define JUMP_MIN 0.05 /* that the firmware bears as a motion; it reported OVER_CURRENT after 0.3 within 0.5 ms [rad] */
#define RK4_SPEED 1000.0 /* more than the reversal of a motor at its highest speed, 419 rad/s [rad/s] */
#define CALIB_MAX 1.0 /* of a shaft at rest: 0.1 [s] */
#define SEARCH_SPEED 0.1 /* above that of a resting shaft; others turned at 1 to 250 [rad/s] */

double drive_gear(const mjModel *m, int actuator) { return m->actuator_gear[6 * m->actuator_outadr[actuator]]; }

int drive_joints(const mjModel *m, int actuator)
{
    return (m->actuator_trntype[actuator] == mjTRN_TENDON) ? m->tendon_num[m->actuator_trnid[2 * actuator]] : 1;
}

int drive_joint(const mjModel *m, int actuator, int k, double *ratio)
{
    const int target = m->actuator_trnid[2 * actuator];
    const double gear = drive_gear(m, actuator);
    if (m->actuator_trntype[actuator] == mjTRN_TENDON) {
        const int wrap = m->tendon_adr[target] + k;
        *ratio = gear * m->wrap_prm[wrap];
        return m->wrap_objid[wrap];
    }
    *ratio = gear;
    return target;
}

void drive_motion(const mjModel *m, const mjData *d, int actuator, double *theta, double *omega)
{
    *theta = 0.0;
    *omega = 0.0;
    for (int k = 0; k < drive_joints(m, actuator); k++) {
        double ratio;
        const int joint = drive_joint(m, actuator, k, &ratio);
        *theta += ratio * d->qpos[m->jnt_qposadr[joint]];
        *omega += ratio * d->qvel[m->jnt_dofadr[joint]];
    }
}

double drive_inertia(const mjModel *m, mjData *d, int actuator)
{
    double mobility = 0.0; /* acceleration by a torque of 1 N m at the motor */
    mj_markStack(d);
    mjtNum *force = mj_stackAllocNum(d, (size_t)m->nv);
    mjtNum *acceleration = mj_stackAllocNum(d, (size_t)m->nv);
    mju_zero(force, (int)m->nv);
    for (int k = 0; k < drive_joints(m, actuator); k++) {
        double ratio;
        const int joint = drive_joint(m, actuator, k, &ratio);
        force[m->jnt_dofadr[joint]] += ratio;
    }
    mj_solveM(m, d, acceleration, force, 1);
    for (int k = 0; k < m->nv; k++) {
        mobility += force[k] * acceleration[k];
    }
    mj_freeStack(d);
    return 1.0 / mobility;
}

static double torque_constant(const exported_t *board, const drive_t *drive, int axis)
{
    board_truth_t truth;
    board_truth(exported_board(board), axis, &truth);
    return 1.5 * exported_number(board, drive->pole_pairs) * truth.psi_m;
}

/* The control signal of an actuator in the last step, as MuJoCo delays and clamps it. */
static double signal_of(const mjModel *m, const mjData *d, int actuator)
{
    const int channel = m->actuator_ctrladr[actuator];
    const double *range = m->actuator_ctrlrange + 2 * channel;
    double signal = d->ctrl[channel];
    if (m->actuator_delay[actuator] != 0.0) {
        const double *kept =
            mj_readCtrl(m, d, actuator, d->time - m->opt.timestep, &signal, m->actuator_history[2 * actuator + 1]);
        signal = (kept != NULL) ? *kept : signal;
    }
    const bool limited = m->actuator_ctrllimited[channel] && (m->opt.disableflags & mjDSBL_CLAMPCTRL) == 0;
    return (limited && !isnan(signal)) ? fmin(fmax(signal, range[0]), range[1]) : signal;
}

bool drive_disabled(const mjModel *m, int actuator)
{
    const int group = m->actuator_group[actuator];
    return group >= 0 && group < 31 && ((unsigned)m->opt.disableactuator >> (unsigned)group & 1u) != 0;
}

static void warn(exported_result_t result)
{
    if (result.status != EXPORTED_DONE) {
        mju_warning(PLUGIN_NAME ": %s: %s", result.where, result.what);
    }
}

static exported_point_t next_point(const drive_t *drive, int axis, coupled_axis_t *of, double signal,
                                   const exported_t *board, uint64_t interval_ns)
{
    const exported_point_t point = {
        .axis = axis,
        .tick = (uint32_t)exported_number(board, drive->tick) + (uint32_t)((interval_ns + AHEAD_NS) / PERIOD_NS),
        .position = of->last - of->zero,
        .velocity = (signal - of->before) / (2e-9 * (double)interval_ns), /* central difference */
    };
    of->path = PATH_RUNS;
    of->before = of->last;
    of->last = signal;
    return point;
}

void drive_follow(const mjModel *m, const mjData *d, const drive_t drive[AXES], coupled_axis_t of[AXES],
                  const exported_t *board, uint64_t step_ns)
{
    const uint64_t steps = (POINT_NS + step_ns - 1) / step_ns;
    exported_point_t points[AXES];
    size_t n = 0;
    if (board_time_ns(exported_board(board)) / step_ns % steps != 0) {
        return;
    }
    const double refusal = exported_number(board, drive[0].point_refusal);
    const bool refused = refusal != POINT_REFUSAL_NONE && refusal != POINT_REFUSAL_MODE;
    for (int axis = 0; axis < AXES; axis++) {
        if (of[axis].path == PATH_RUNS && refused) {
            mju_warning(PLUGIN_NAME
                        ": actuator %d: the firmware refuses the path (point_refusal %g); let ctrl change smoothly",
                        drive[axis].actuator, refusal);
            of[axis].path = PATH_NONE;
        } else if (of[axis].path != PATH_NONE) {
            const double signal = signal_of(m, d, drive[axis].actuator);
            points[n++] = next_point(&drive[axis], axis, &of[axis], isnan(signal) ? of[axis].last : signal, board,
                                     steps * step_ns);
        }
    }
    const exported_result_t result = (n > 0) ? exported_points(board, points, n) : (exported_result_t){EXPORTED_DONE};
    warn(result);
    for (size_t k = 0; k < n && result.status != EXPORTED_DONE; k++) {
        of[points[k].axis].path = PATH_NONE;
    }
}

static void give(exported_t *board, const drive_t *drive, coupled_axis_t *of, double set_point)
{
    const exported_result_t result = exported_set(board, drive->set_point, set_point);
    const bool refused = result.status != EXPORTED_DONE;
    if (refused && of->refused == 0) { /* once, not in every step */
        mju_warning(PLUGIN_NAME
                    ": actuator %d: %s = %g: %s, and keeps the last one; limit ctrl, for example by ctrlrange",
                    drive->actuator, result.where, set_point, result.what);
    }
    of->refused = refused ? 1 : 0;
}

/* A path begins where the shaft has been moved to. */
static void approach(const drive_t *drive, coupled_axis_t *of, double signal, exported_t *board)
{
    const double target = signal - of->zero;
    const bool rests = of->last == signal;
    of->last = of->before = signal;
    if (exported_number(board, drive->mode_command) != CONTROL_MODE_POSITION) {
        /* The set-point of the shaft's place: the next one is then a change, also if it is that of the last move. */
        warn(exported_set(board, drive->mode_command, CONTROL_MODE_POSITION));
        warn(exported_set(board, drive->set_point, exported_number(board, drive->position)));
    } else if (rests && exported_number(board, drive->set_point) == target &&
               fabs(exported_number(board, drive->position) - target) < ARRIVED) {
        of->path = PATH_BEGINS;
        warn(exported_set(board, drive->mode_command, CONTROL_MODE_TRAJECTORY));
    } else {
        give(board, drive, of, target);
    }
}

/* The new position is in the next snapshot only, a slow tick after the result, and with it the state. */
static bool shifts(const exported_t *board, const drive_t *drive)
{
    const double state = exported_number(board, drive->home_state);
    return exported_number(board, drive->home_result) == HOME_RESULT_DONE && state != HOME_STATE_KNOWN &&
           state != HOME_STATE_ASSUMED;
}

/* True while the axis homes: a set-point would end that. */
static bool homes(exported_t *board, const drive_t *drive, coupled_axis_t *of)
{
    const double result = exported_number(board, drive->home_result);
    if (drive->home == HOME_METHOD_NONE || of->homing == HOMING_ENDED) {
        return false;
    }
    if (of->homing == HOMING_WAITS) {
        warn(exported_set(board, drive->home_command, drive->home));
        of->homing = HOMING_RUNS;
    } else if (result != HOME_RESULT_NONE && result != HOME_RESULT_RUNNING && !shifts(board, drive)) {
        of->homing = HOMING_ENDED;
        of->zero = NAN; /* the position has changed */
        if (result != HOME_RESULT_DONE) {
            mju_warning(PLUGIN_NAME ": actuator %d: the firmware has not homed the axis (home_result %g)",
                        drive->actuator, result);
        }
        if (drive->mode != CONTROL_MODE_TRAJECTORY) {
            warn(exported_set(board, drive->mode_command, drive->mode));
        }
    }
    return of->homing != HOMING_ENDED;
}

/* Length of the motion in a time step beyond that of its speed [rad]. Every integrator but RK4 moves a joint by exactly its new
 * speed times the step, also in contacts. RK4 moves it by a mean of the speeds within the step. */
static double jump_min(const mjModel *m)
{
    return JUMP_MIN + ((m->opt.integrator == mjINT_RK4) ? RK4_SPEED * m->opt.timestep : 0.0);
}

void drive_couple(const mjModel *m, const mjData *d, const board_t *board, const drive_t *drive, int axis,
                  coupled_axis_t *of)
{
    board_truth_t truth;
    double theta;
    double omega;
    drive_motion(m, d, drive->actuator, &theta, &omega);
    board_truth(board, axis, &truth);
    const double jump = theta + of->offset - (truth.theta_m + omega * m->opt.timestep);
    if (isfinite(jump) && fabs(jump) > jump_min(m) && fabs(omega) <= BOARD_SPEED_MAX) {
        of->offset -= jump;
        of->zero += jump;
        of->path = PATH_NONE;
        of->last = NAN;
        mju_warning(PLUGIN_NAME ": actuator %d: the joint has jumped by %g rad of the motor; the shaft is coupled to "
                                "it anew, and angles of its switches have moved by as much",
                    drive->actuator, jump);
    }
}

void drive_shaft(const mjModel *m, const mjData *d, board_t *board, const drive_t *drive, int axis, coupled_axis_t *of)
{
    double theta;
    double omega;
    drive_motion(m, d, drive->actuator, &theta, &omega);
    const char *problem = board_drive_shaft(board, axis, theta + of->offset, omega, m->opt.timestep);
    if (problem != NULL && of->too_fast == 0) {
        mju_warning(PLUGIN_NAME ": actuator %d: %s", drive->actuator, problem);
    }
    of->too_fast = (problem != NULL) ? 1 : 0;
}

/* A model without sensors of the board shows nothing else of a fault. The firmware ends a search of a rotor that does not come to
 * rest by several of them. */
static void watch_faults(const mjModel *m, mjData *d, const drive_t *drive, coupled_axis_t *of, const exported_t *board)
{
    const uint64_t faults = (uint64_t)exported_number(board, drive->faults);
    double theta;
    double omega;
    drive_motion(m, d, drive->actuator, &theta, &omega);
    for (unsigned bit = 0; bit < 32; bit++) {
        if (((faults & ~of->faults) >> bit & 1u) == 0) {
            continue;
        }
        if (of->substate == SUBSTATE_ALIGN && fabs(omega) > SEARCH_SPEED) {
            mju_warning(
                PLUGIN_NAME
                ": actuator %d: fault %s in the rotor search, while the shaft turned at %g rad/s with %.1f times the "
                "inertia of its rotor, which should be below 4; if it did not come to rest, give the joint the friction of the motor (frictionloss: friction in the plant "
                "times gear), or take a smaller time step; if both motors turn one shaft, write <config "
                "key=\"shaft\" value=\"SHARED\"/>",
                drive->actuator, exported_fault_name(bit), omega,
                drive_inertia(m, d, drive->actuator) / exported_number(board, drive->inertia));
        } else {
            mju_warning(PLUGIN_NAME ": actuator %d: fault %s", drive->actuator, exported_fault_name(bit));
        }
    }
    of->faults = faults;
}

/* The firmware waits for a shaft at rest, without end. */
static void watch_calibration(const mjModel *m, const mjData *d, const drive_t *drive, coupled_axis_t *of)
{
    const double before = of->waited;
    of->waited = (of->substate == SUBSTATE_CALIB) ? before + m->opt.timestep : 0.0;
    if (before < CALIB_MAX && of->waited >= CALIB_MAX) {
        double theta;
        double omega;
        drive_motion(m, d, drive->actuator, &theta, &omega);
        mju_warning(
            PLUGIN_NAME
            ": actuator %d: the firmware waits in CALIB until the shaft rests, which turns at %g rad/s; hold the "
            "load until the rotor is found, for example by a holding brake",
            drive->actuator, omega);
    }
}

static control_mode_t first_mode(const drive_t *drive)
{
    return (drive->mode == CONTROL_MODE_TRAJECTORY || drive->home != HOME_METHOD_NONE) ? CONTROL_MODE_POSITION
                                                                                       : drive->mode;
}

/* Enable an axis once no other motor at its shaft searches. True when it has its mode. */
static bool searched(exported_t *board, const drive_t drive[AXES], int axis, coupled_axis_t of[AXES])
{
    const drive_t *own = &drive[axis];
    uint64_t *search = &of[axis].search;
    const bool other_ended = !own->shares || of[1 - axis].search >= SEARCH_ENDED;
    if (*search == SEARCH_WAITS && exported_number(board, own->state) == STATE_STOP && (axis == 0 || other_ended)) {
        warn(exported_set(board, own->mode_command, own->shares ? CONTROL_MODE_POSITION : first_mode(own)));
        warn(exported_set(board, own->enable, 1.0));
        *search = SEARCH_RUNS;
    }
    if (*search == SEARCH_RUNS && (of[axis].substate == SUBSTATE_SPIN || of[axis].faults != 0)) {
        if (own->shares) { /* only a change in SPIN is a set-point, of no current */
            warn(exported_set(board, own->mode_command, CONTROL_MODE_TORQUE));
        }
        *search = SEARCH_ENDED;
    }
    if (*search == SEARCH_ENDED && other_ended) {
        warn(exported_set(board, own->mode_command, first_mode(own)));
        *search = SEARCH_LEFT;
    }
    return *search == SEARCH_LEFT;
}

void drive_command(const mjModel *m, mjData *d, exported_t *board, const drive_t drives[AXES], int axis,
                   coupled_axis_t states[AXES])
{
    const drive_t *drive = &drives[axis];
    coupled_axis_t *of = &states[axis];
    watch_faults(m, d, drive, of, board);
    of->substate = (exported_number(board, drive->state) == STATE_RUN) ? exported_number(board, drive->substate)
                                                                       : SUBSTATE_FREEWHEEL;
    watch_calibration(m, d, drive, of);
    if (!searched(board, drives, axis, states) || of->substate != SUBSTATE_SPIN) {
        of->path = PATH_NONE;
        return;
    }
    if (homes(board, drive, of)) {
        return;
    }
    double signal = signal_of(m, d, drive->actuator);
    if (isnan(of->zero)) {
        double omega;
        drive_motion(m, d, drive->actuator, &of->zero, &omega);
        of->zero -= exported_number(board, drive->position);
        of->last = NAN;
    }
    if (isnan(signal)) {
        return; /* MuJoCo warns */
    }
    switch (drive->mode) {
    case CONTROL_MODE_TRAJECTORY:
        if (of->path == PATH_NONE) {
            approach(drive, of, signal, board);
        }
        break;
    case CONTROL_MODE_POSITION:
        give(board, drive, of, signal - of->zero);
        break;
    case CONTROL_MODE_TORQUE:
        give(board, drive, of, signal / torque_constant(board, drive, axis));
        break;
    default:
        give(board, drive, of, signal);
        break;
    }
}
