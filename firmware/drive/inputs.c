#include "drive/inputs.h"

#include "drive/axis_faults.h"
#include "drive/limits.h"
#include "drive/motion.h"

/* Bounce time: a contact that opens and closes again within this time while the shaft leaves the switch is ignored
 * [slow ticks]. */
#define BOUNCE_TICKS 100U

void inputs_configure(axis_t *axis)
{
    hal_enable_input(axis->hal, axis->index, (axis->config->pins.fitted & INPUT_ENABLE) != 0U);
}

bool inputs_permit(const axis_t *axis)
{
    const uint16_t missing = axis->config->pins.fitted & (uint16_t)~axis->inputs;
    return (missing & INPUT_ENABLE) == 0U && (axis->inputs & INPUT_LIMITS) != INPUT_LIMITS;
}

/* A changed level is accepted in its second slow tick. */
static uint16_t filtered(axis_t *axis, uint16_t levels)
{
    const uint16_t changing = levels ^ axis->inputs_state.last_levels;
    axis->inputs_state.last_levels = levels;
    return (uint16_t)((axis->inputs & changing) | (levels & (uint16_t)~changing));
}

/* The hardware has already switched the outputs off, so the fault is raised without filtering. At rest an open input is
 * no fault, and it is armed again when it closes. */
static void check_enable(axis_t *axis)
{
    if ((axis->config->pins.fitted & INPUT_ENABLE) == 0U || (axis->inputs_state.last_levels & INPUT_ENABLE) != 0U) {
        return;
    }
    axis->inputs = (uint16_t)(axis->inputs & (uint16_t)~INPUT_ENABLE);
    if (axis->sm.state == STATE_RUN || axis->enable_requested) {
        axis_raise(axis, FOUND(FINDING_ENABLE_OPEN));
    } else {
        inputs_configure(axis);
    }
}

/* A switch in the direction of motion; or one behind the shaft, which the shaft cannot have reached: its wire is
 * broken, or the wrong switch is connected. */
static bool reached(const axis_t *axis, uint16_t fresh)
{
    const frac32_t speed = axis->feedback.speed;
    const bool ahead =
        ((fresh & INPUT_LIMIT_MAX) != 0U && speed >= 0) || ((fresh & INPUT_LIMIT_MIN) != 0U && speed <= 0);
    return ahead || axis->inputs_state.inactive_ticks > BOUNCE_TICKS;
}

static void check_limits(axis_t *axis, uint16_t before)
{
    const uint16_t fresh = axis->inputs & (uint16_t)~before & INPUT_LIMITS;
    const bool driven =
        axis->substate == SUBSTATE_SPIN || axis->substate == SUBSTATE_STARTUP || axis->substate == SUBSTATE_TEST;
    if (fresh != 0U) {
        limits_tighten(axis);
        if (axis->sm.state == STATE_RUN && driven && reached(axis, fresh)) {
            axis_raise(axis, FOUND(FINDING_LIMIT_SWITCH));
            motion_leave_path(axis); /* also if the fault is not enabled */
        }
    }
    if ((axis->inputs & INPUT_LIMITS) != 0U) {
        axis->inputs_state.inactive_ticks = 0;
    } else if (axis->inputs_state.inactive_ticks < UINT16_MAX) {
        axis->inputs_state.inactive_ticks++;
    }
}

void inputs_step(axis_t *axis)
{
    const uint16_t fitted = axis->config->pins.fitted & (INPUT_HOME | INPUT_LIMITS | INPUT_ENABLE);
    const uint16_t before = axis->inputs;
    if (fitted == 0U) {
        axis->inputs = 0;
    } else {
        axis->inputs = filtered(axis, hal_inputs(axis->hal, axis->index) & fitted);
        check_enable(axis);
        check_limits(axis, before);
    }
    const bool held = !inputs_permit(axis) || (axis->inputs & INPUT_LIMITS) != 0U;
    axis->input_limits = held ? LIMIT_INPUT : 0U;
}
