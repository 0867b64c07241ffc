#include "drive/test_signal.h"

#include "drive/current_drive.h"
#include "drive/inputs.h"

static bool fast(uint16_t point) { return point == TEST_POINT_I_D || point == TEST_POINT_I_Q; }

/* Homing evaluates currents and speeds itself, without a test signal. */
static bool homing(const axis_t *axis)
{
    return axis->motion.motion == MOTION_HOME || axis->motion.motion == MOTION_PRESS;
}

/* The axis is coming to rest. */
static bool stopping(const axis_t *axis)
{
    return axis->motion.motion == MOTION_STOP || axis->motion.underrun || homing(axis);
}

static bool possible(const axis_t *axis, uint16_t point)
{
    const bool requested = axis->enable_requested && !axis->command.quick_stop && !axis->motion.expired;
    if (axis->sm.state != STATE_RUN || !requested || (axis->inputs & INPUT_LIMITS) != 0U) {
        return false;
    }
    return (axis->substate == SUBSTATE_SPIN) ? !stopping(axis) : (axis->substate == SUBSTATE_TEST && fast(point));
}

/* Largest amplitude of the signal: the vector sum of set-point and signal stays within the limit of i_q. Set-points
 * change once per slow tick. */
static frac16_t amplitude_max(const axis_t *axis)
{
    const frac16_t max = axis->current_max.q;
    const frac16_t other =
        f16_limit((axis->test_signal.point == TEST_POINT_I_D) ? axis->current_ref.q : axis->current_ref.d, max);
    return f16_sqrt(f32_mul16(max, max) - f32_mul16(other, other));
}

static void end(axis_t *axis)
{
    test_signal_t *signal = &axis->test_signal;
    *signal = (test_signal_t){.point = TEST_POINT_NONE};
    axis->motion.speed_test_signal = 0;
    if (axis->fast == LOOP_TEST_SIGNAL) {
        axis->fast = axis->estimate.runs ? LOOP_OBSERVED : LOOP_FAST;
    }
}

void test_signal_start(axis_t *axis, uint16_t point, const swept_sine_t *sine)
{
    end(axis);
    if (point != TEST_POINT_NONE && possible(axis, point)) {
        axis->test_signal.point = point;
        axis->test_signal.sine = *sine;
    }
}

void test_signal_step(axis_t *axis)
{
    test_signal_t *signal = &axis->test_signal;
    if (signal->point == TEST_POINT_NONE) {
        return; /* the usual case */
    }
    if (!possible(axis, signal->point) || signal->sine.calls == 0U) {
        end(axis);
        return;
    }
    signal->limit = amplitude_max(axis);
    if (fast(signal->point)) {
        axis->fast = LOOP_TEST_SIGNAL;
        return;
    }
    signal->value = swept_sine_step(&signal->sine);
    if (signal->point == TEST_POINT_SPEED) {
        axis->motion.speed_test_signal = f32_from_f16(signal->value);
    } else {
        axis->test_current.q = f16_add(axis->test_current.q, signal->value);
    }
}

void test_signal_drive(axis_t *axis, frac16_t theta_e)
{
    test_signal_t *signal = &axis->test_signal;
    const dq_t without_signal = axis->current_ref;
    frac16_t *set_point = (signal->point == TEST_POINT_I_D) ? &axis->current_ref.d : &axis->current_ref.q;
    signal->value = swept_sine_step(&signal->sine);
    *set_point = f16_limit((int32_t)*set_point + signal->value, signal->limit);
    if (axis->estimate.runs) {
        drive_observed(axis, theta_e);
    } else {
        drive_current(axis, theta_e);
    }
    axis->current_ref = without_signal; /* slow loop and recorder use the set-point without the signal */
}
