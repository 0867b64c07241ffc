#include "drive/test_mode.h"

#include "drive/current_drive.h"
#include "drive/holding_brake.h"
#include "drive/limits.h"
#include "drive/motion.h"
#include "drive/soft_limits.h"
#include "drive/test_signal.h"

/* The imposed vector uses the state of the sensorless start-up, which an axis with an encoder does not need. */

bool test_mode_requested(const axis_t *axis)
{
    const bool able = !axis->sensorless && !holding_brake_fitted(axis);
    return axis->enable_requested && !axis->command.quick_stop && axis->command.mode == CONTROL_MODE_TEST && able;
}

void test_mode_start(axis_t *axis)
{
    axis->startup = (startup_t){0};
    axis->motion.speed_target = 0;
    axis->motion.i_q_target = 0;
    axis->motion.expired = false;
    axis->diagnosis.shaft = (shaft_monitor_t){0};
    limits_renew(axis);
}

static frac16_t next_angle(const startup_t *vector) { return (frac16_t)(uint16_t)(vector->angle >> 16); }

void test_mode_fast(axis_t *axis)
{
    drive_current(axis, next_angle(&axis->startup));
    axis->startup.angle += (uint32_t)axis->startup.step;
}

void test_mode_signal_fast(axis_t *axis)
{
    test_signal_drive(axis, next_angle(&axis->startup));
    axis->startup.angle += (uint32_t)axis->startup.step;
}

frac16_t test_mode_angle(const axis_t *axis)
{
    return (frac16_t)(uint16_t)((axis->startup.angle - (uint32_t)axis->startup.step) >> 16);
}

/* Set-points take effect when written. After a timeout the vector stops at its angle, because it may hold a load. */
static void take_set_points(axis_t *axis)
{
    motion_state_t *m = &axis->motion;
    const axis_command_t *command = &axis->command;
    if ((command->fresh & FRESH_I_Q) != 0U) {
        m->i_q_target = command->i_q;
    }
    if ((command->fresh & FRESH_SPEED) != 0U) {
        m->speed_target = command->speed;
    }
    if (axis_set_point_fresh(command)) {
        m->expired = false;
        limits_renew(axis);
    }
    motion_expire_speed(axis);
}

/* Speed of the vector within the limits; 0 if it would turn the shaft out of its range. */
static frac32_t requested_speed(axis_t *axis)
{
    const frac32_t speed = f32_clip(axis->motion.speed_target, axis->limits.speed);
    const frac32_t confined = soft_limits_given(axis) ? soft_limits_confined(axis, speed) : speed;
    if (confined != speed) {
        axis_report(axis, axis->home.limit);
    } else if (speed != axis->motion.speed_target) {
        axis_report(axis, LIMIT_SPEED);
    }
    return confined;
}

void test_mode_slow(axis_t *axis)
{
    startup_t *vector = &axis->startup;
    take_set_points(axis);
    vector->speed += f32_clip(f32_sub(requested_speed(axis), vector->speed), axis->limits.acceleration);
    vector->step = f32_gain(vector->speed, axis->config->current_loop.angle_step);
    const frac16_t requested = f16_limit(axis->motion.i_q_target, axis->current_max.q);
    if (requested != axis->motion.i_q_target) {
        axis_report(axis, LIMIT_CURRENT);
    }
    const frac32_t missing = f32_sub(f32_from_f16(requested), vector->current);
    vector->current += f32_clip(missing, axis->config->rotor_search.current_slew);
    axis->current_ref = (dq_t){f16_from_f32(vector->current), 0};
    current_loop_set_speed(&axis->current_loop, &axis->config->current_loop, f16_from_f32(vector->speed));
}
