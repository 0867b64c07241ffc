#include "drive/homing.h"

#include "drive/axis_faults.h"
#include "drive/holding_brake.h"
#include "drive/inputs.h"
#include "drive/motion.h"
#include "drive/path_units.h"
#include "drive/set_position.h"

/* Legs of a homing: approaches have odd numbers, the back-off after each of them the next even number. The first
 * approach is fast and only gives the approximate position for the others. */
#define LEG_NONE 0U
#define LEG_REQUESTED 1U  /* begins in the next step */
#define LEG_LIMITS 2U     /* the limits of the homing take effect in the next step */
#define LEG_CLEAR 4U      /* back off from a switch that is already active */
#define LEG_FIRST 5U
#define LEG_LAST 12U      /* back-off after the fourth approach */
#define LEG_SETTLE 13U    /* at rest, then position hold */

#define SLOWER_SHIFT 2    /* of the approaches after the first: a quarter of the speed */
#define STAND_COUNTS 1    /* dither of a shaft at standstill */
#define TOUCH_COUNTS 4    /* contact: the distance that the set speed would have covered while the shaft stood .. */
#define TOUCH_TICKS 8U    /* .. for at least this number of slow ticks: then the full current is applied */
#define STAND_TICKS 100U  /* slow ticks of standstill at full current that count as a contact */
#define TIMEOUT_UNIT 64U  /* slow ticks per unit of home_t.timeout */
#define TIMEOUT_MIN 64U   /* 2 s: for acceleration, contact and reversal */

/* Faults that invalidate the encoder count. */
#define COUNT_LOST (FAULT_ENCODER | FAULT_ENCODER_LOST | FAULT_ENCODER_REVERSED | FAULT_ANGLE_MISMATCH)

void homing_init(axis_t *axis) { axis->home = (home_t){.limit = LIMIT_POSITION}; }

static bool trusted(const home_t *home) { return home->state == HOME_STATE_KNOWN || home->state == HOME_STATE_ASSUMED; }

/* Without a home position the shaft must stay near the position at which the axis was enabled. */
static bool confined(const axis_t *axis)
{
    const bool on = (axis->parameter.features & FEATURE_HOMING) != 0U && !axis->sensorless;
    return on && axis->home.state == HOME_STATE_UNKNOWN;
}

static void set_state(axis_t *axis, uint16_t state)
{
    axis->home.state = state;
    axis->home.refused_limit = 0;
    axis->home.limits_stale = true;
}

/* ---- queries -------------------------------------------------------------------------------------------------------- */

void homing_forget(axis_t *axis)
{
    if (trusted(&axis->home)) {
        set_state(axis, HOME_STATE_UNKNOWN);
    }
}

void homing_spin(axis_t *axis)
{
    if (axis->home.leg == LEG_NONE) {
        axis->home.origin = axis->feedback.position;
    }
    homing_confine(axis, &axis->written_limits);
}

void homing_confine(axis_t *axis, axis_limits_t *limits)
{
    home_t *home = &axis->home;
    home->limit = LIMIT_POSITION;
    if (home->state == HOME_STATE_HOMING) {
        const frac16_t own = axis->config->home.current;
        limits->i_q = (limits->i_q < own) ? limits->i_q : own;
        limits->position_min = INT32_MIN;
        limits->position_max = INT32_MAX;
    } else if (confined(axis)) {
        const int32_t reach = (int32_t)axis->config->home.reach;
        limits->position_min = i32_sub_wrap(home->origin, reach);
        limits->position_max = i32_add_wrap(home->origin, reach);
        home->limit = LIMIT_NOT_HOMED;
    }
}

/* ---- the end of a homing -------------------------------------------------------------------------------------------- */

static void end(axis_t *axis, home_result_t result)
{
    home_t *home = &axis->home;
    const bool moved = home->leg > LEG_REQUESTED;
    home->result = (uint16_t)result;
    home->leg = LEG_NONE;
    if (moved && result != HOME_RESULT_DONE) {
        home->origin = axis->feedback.position;
        set_state(axis, HOME_STATE_UNKNOWN);
    }
}

static void fail(axis_t *axis, home_result_t result)
{
    end(axis, result);
    motion_rest(axis);
    axis_raise(axis, FOUND(FINDING_HOMING_FAILED));
}

static void set_zero(axis_t *axis, int32_t from, uint16_t state)
{
    set_position_shift(axis, i32_sub_wrap(axis->home.value, from));
    set_state(axis, state);
    end(axis, HOME_RESULT_DONE);
}

uint16_t homing_filter(axis_t *axis, uint16_t fresh, int32_t position)
{
    const uint16_t moves = FRESH_POSITION | FRESH_SPEED | FRESH_I_Q | FRESH_POINTS | FRESH_MODE | FRESH_QUICK_STOP;
    home_t *home = &axis->home;
    if ((fresh & moves) == 0U) {
        return fresh;
    }
    if (home->leg != LEG_NONE) {
        end(axis, HOME_RESULT_ABORTED);
        motion_rest(axis);
    }
    const int32_t off = i32_sub_wrap(position, home->origin);
    const int32_t reach = (int32_t)axis->config->home.reach;
    const bool far = (fresh & FRESH_POSITION) != 0U && confined(axis) && (off > reach || off < -reach);
    home->refused_limit = far ? LIMIT_NOT_HOMED : 0U;
    return far ? (uint16_t)(fresh & (uint16_t)~FRESH_POSITION) : fresh;
}

void homing_request(axis_t *axis, uint16_t method, int32_t value)
{
    home_t *home = &axis->home;
    if (home->leg != LEG_NONE) {
        end(axis, HOME_RESULT_ABORTED);
        motion_rest(axis);
    }
    if (method != HOME_METHOD_NONE) {
        home->method = method;
        home->value = value;
        home->result = HOME_RESULT_RUNNING;
        home->leg = LEG_REQUESTED;
    }
}

/* ---- the legs ------------------------------------------------------------------------------------------------------- */

static bool approaches(uint16_t leg) { return (leg & 1U) != 0U; }

static bool by_switch(const home_t *home) { return home->method >= HOME_METHOD_SWITCH_POSITIVE; }

static int32_t direction(const home_t *home)
{
    return (home->method == HOME_METHOD_STOP_NEGATIVE || home->method == HOME_METHOD_SWITCH_NEGATIVE) ? -1 : 1;
}

static bool active(const axis_t *axis) { return (axis->inputs & INPUT_HOME) != 0U; }

static uint32_t distance_max(const axis_t *axis)
{
    const home_config_t *config = &axis->config->home;
    return approaches(axis->home.leg) ? (uint32_t)config->turns_max * POSITION_PER_TURN : config->back_off;
}

/* Timeout: twice the time that the distance takes at this speed. */
static uint16_t time_for(const axis_t *axis, frac32_t speed)
{
    const path_position_t step = path_step_of(axis->config, speed);
    const uint32_t per_unit = (uint32_t)asr64(step * (path_position_t)TIMEOUT_UNIT, PATH_BITS);
    const uint32_t units = 2U * distance_max(axis) / ((per_unit != 0U) ? per_unit : 1U) + TIMEOUT_MIN;
    return (units < UINT16_MAX) ? (uint16_t)units : UINT16_MAX;
}

/* Speed of the present leg, signed. */
static frac32_t leg_speed(const axis_t *axis)
{
    const home_t *home = &axis->home;
    const bool approach = approaches(home->leg);
    const frac32_t fast = f32_from_f16(axis->config->home.speed);
    const frac32_t speed = (approach && home->leg != LEG_FIRST) ? asr32(fast, SLOWER_SHIFT) : fast;
    return (approach == (direction(home) > 0)) ? speed : -speed;
}

static void begin_leg(axis_t *axis, uint16_t leg)
{
    home_t *home = &axis->home;
    home->leg = leg;
    home->ticks = 0;
    home->rest_position = axis->feedback.position;
    home->origin = axis->feedback.position;
    const frac32_t speed = leg_speed(axis);
    home->timeout = time_for(axis, f32_abs(speed));
    motion_home(axis, speed);
}

/* The shaft stands against a stop that withstands the full current. */
static bool stands(axis_t *axis)
{
    home_t *home = &axis->home;
    const frac32_t speed = leg_speed(axis);
    const int32_t off = i32_sub_wrap(axis->feedback.position, home->rest_position);
    const int32_t count = axis->encoder.resolution;
    if (off > STAND_COUNTS * count || off < -STAND_COUNTS * count) {
        home->rest_position = axis->feedback.position;
        home->ticks = 0;
        motion_home(axis, speed);
        return false;
    }
    home->ticks++;
    const path_position_t missed = path_step_of(axis->config, f32_abs(speed)) * home->ticks;
    if (home->ticks >= TOUCH_TICKS && missed >= path_counts(TOUCH_COUNTS * count)) {
        motion_press(axis, (speed < 0) ? f16_neg(axis->limits.i_q) : axis->limits.i_q);
    }
    return home->ticks >= STAND_TICKS && axis->motion.motion == MOTION_PRESS;
}

/* The position of the first approach is not used: it was found at another speed. */
static void note_place(home_t *home, int32_t place)
{
    const int32_t off = i32_sub_wrap(place, home->lowest);
    if (home->leg <= LEG_FIRST + 2U) {
        home->lowest = place;
        home->spread = 0;
    } else if (off < 0) {
        const uint32_t spread = (uint32_t)home->spread + (uint32_t)-off;
        home->spread = (spread < UINT16_MAX) ? (uint16_t)spread : UINT16_MAX;
        home->lowest = place;
    } else if (off > (int32_t)home->spread) {
        home->spread = (off < (int32_t)UINT16_MAX) ? (uint16_t)off : UINT16_MAX;
    }
}

/* True if a limit switch is active in the direction of the present leg. */
static bool at_limit_switch(const axis_t *axis)
{
    const uint16_t ahead = (leg_speed(axis) < 0) ? INPUT_LIMIT_MIN : INPUT_LIMIT_MAX;
    return (axis->inputs & ahead) != 0U;
}

static home_result_t approach(axis_t *axis, int32_t distance)
{
    home_t *home = &axis->home;
    if (at_limit_switch(axis)) {
        return HOME_RESULT_BLOCKED;
    }
    const bool still = stands(axis);
    if (by_switch(home) ? active(axis) : still) {
        note_place(home, axis->feedback.position);
        if (home->spread > axis->config->home.spread_max) {
            return HOME_RESULT_SPREAD;
        }
        begin_leg(axis, (uint16_t)(home->leg + 1U));
        return HOME_RESULT_RUNNING;
    }
    if (still) {
        return HOME_RESULT_BLOCKED;
    }
    return ((uint32_t)((distance < 0) ? -distance : distance) > distance_max(axis)) ? HOME_RESULT_NOT_FOUND
                                                                                    : HOME_RESULT_RUNNING;
}

static home_result_t back_off(axis_t *axis, int32_t distance)
{
    home_t *home = &axis->home;
    if (at_limit_switch(axis) || stands(axis)) {
        return HOME_RESULT_STUCK;
    }
    if (by_switch(home) && active(axis)) {
        home->origin = axis->feedback.position; /* the back-off distance counts from the edge of the switch */
    } else if (-direction(home) * distance >= (int32_t)axis->config->home.back_off) {
        if (home->leg == LEG_LAST) {
            home->leg = LEG_SETTLE;
            motion_rest(axis);
        } else {
            begin_leg(axis, (uint16_t)(home->leg + 1U));
        }
    }
    return HOME_RESULT_RUNNING;
}

static bool out_of_time(axis_t *axis)
{
    home_t *home = &axis->home;
    home->timeout =
        (uint16_t)(home->timeout - (((*axis->latch.clock / AXIS_SLOW_PERIODS) % TIMEOUT_UNIT == 0U) ? 1U : 0U));
    return home->timeout == 0U;
}

static void run_leg(axis_t *axis)
{
    const home_t *home = &axis->home;
    const int32_t distance = i32_sub_wrap(axis->feedback.position, home->origin);
    home_result_t result = approaches(home->leg) ? approach(axis, distance) : back_off(axis, distance);
    if (result == HOME_RESULT_RUNNING && out_of_time(axis)) {
        result = HOME_RESULT_TIMEOUT;
    }
    if (result != HOME_RESULT_RUNNING) {
        fail(axis, result);
    }
}

/* ---- start and end of a homing -------------------------------------------------------------------------------------- */

static bool held(const axis_t *axis)
{
    return axis->sm.state == STATE_RUN && axis->substate == SUBSTATE_SPIN && axis->enable_requested &&
           axis->latch.captured == 0U && !axis->command.quick_stop && holding_brake_is_open(axis);
}

static home_result_t refusal(const axis_t *axis)
{
    const home_t *home = &axis->home;
    if (axis->sensorless) {
        return HOME_RESULT_SENSORLESS;
    }
    if (home->method == HOME_METHOD_ASSUME && home->state == HOME_STATE_KNOWN) {
        return HOME_RESULT_KNOWN;
    }
    const bool sets = home->method == HOME_METHOD_HERE || home->method == HOME_METHOD_ASSUME;
    return (set_position_permitted(axis) && (sets || held(axis))) ? HOME_RESULT_RUNNING : HOME_RESULT_MOTION;
}

static void take_request(axis_t *axis)
{
    home_t *home = &axis->home;
    const home_result_t refused = refusal(axis);
    if (refused != HOME_RESULT_RUNNING) {
        end(axis, refused);
    } else if (home->method == HOME_METHOD_HERE) {
        set_zero(axis, axis->feedback.position, HOME_STATE_KNOWN);
    } else if (home->method == HOME_METHOD_ASSUME) {
        set_zero(axis, axis->feedback.position, HOME_STATE_ASSUMED);
    } else {
        home->leg = LEG_LIMITS;
        home->spread = 0;
        set_state(axis, HOME_STATE_HOMING);
    }
}

static void proceed(axis_t *axis)
{
    const home_t *home = &axis->home;
    if (!held(axis)) {
        end(axis, HOME_RESULT_ABORTED);
    } else if (home->leg == LEG_SETTLE) {
        if (set_position_permitted(axis)) {
            set_zero(axis, i32_add_wrap(home->lowest, (int32_t)(home->spread / 2U)), HOME_STATE_KNOWN);
        }
    } else if (home->leg != LEG_LIMITS) {
        run_leg(axis);
    } else if (!home->limits_stale) {
        begin_leg(axis, (by_switch(home) && active(axis)) ? LEG_CLEAR : LEG_FIRST);
    }
}

void homing_step(axis_t *axis)
{
    const home_t *home = &axis->home;
    if (home->leg == LEG_REQUESTED) {
        take_request(axis);
    } else if (home->leg != LEG_NONE) {
        proceed(axis);
    } else if ((axis->latch.captured & COUNT_LOST) != 0U) {
        homing_forget(axis);
    }
}
