#include "app/latch.h"

#include <stddef.h>

#include "drive/motion.h"

typedef struct {
    uint16_t offset;
    uint16_t element;
} field_t;

#define FIELD(name) {(uint16_t)offsetof(command_block_t, name), (uint16_t)sizeof(((command_block_t *)0)->name[0])}

static const field_t fields[LATCH_FIELDS] = {
    [LATCH_POSITION] = FIELD(position),
    [LATCH_SPEED] = FIELD(speed),
    [LATCH_I_Q] = FIELD(i_q),
    [LATCH_MODE] = FIELD(mode),
    [LATCH_ENABLE] = FIELD(enable),
    [LATCH_QUICK_STOP] = FIELD(quick_stop),
    [LATCH_CLEAR_FAULTS] = FIELD(clear_faults),
};

void latch_reset(latch_marks_t *marks)
{
    for (uint16_t field = 0; field < LATCH_FIELDS; field++) {
        marks->axes[field] = 0;
    }
    marks->any = false;
}

void latch_mark(latch_marks_t *marks, uint16_t offset, uint16_t size)
{
    for (uint16_t field = 0; field < LATCH_FIELDS; field++) {
        for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
            const uint32_t begin = fields[field].offset + (uint32_t)axis * fields[field].element;
            if (offset < begin + fields[field].element && begin < (uint32_t)offset + size) {
                marks->axes[field] = (uint16_t)(marks->axes[field] | (UINT16_C(1) << axis));
                marks->any = true;
            }
        }
    }
}

static int32_t clip(int32_t value, int32_t least, int32_t most, bool *clipped)
{
    if (value >= least && value <= most) {
        return value;
    }
    *clipped = true;
    return (value < least) ? least : most;
}

static void apply_axis(const latch_marks_t *marks, command_block_t *block, axis_t *axis)
{
    const uint16_t i = axis->index;
    const uint16_t bit = (uint16_t)(UINT16_C(1) << i);
    axis_command_t *command = &axis->command;

    command->fresh_position = (marks->axes[LATCH_POSITION] & bit) != 0U;
    command->fresh_speed = (marks->axes[LATCH_SPEED] & bit) != 0U;
    command->fresh_i_q = (marks->axes[LATCH_I_Q] & bit) != 0U;
    command->fresh_mode = (marks->axes[LATCH_MODE] & bit) != 0U && block->mode[i] <= CONTROL_MODE_TORQUE;
    command->fresh_enable = (marks->axes[LATCH_ENABLE] & bit) != 0U;
    command->fresh_quick_stop = (marks->axes[LATCH_QUICK_STOP] & bit) != 0U;

    command->enable = block->enable[i] == 1U;
    if (command->fresh_enable && command->enable && !command->fresh_quick_stop) {
        block->quick_stop[i] = 0; /* a later enable releases the quick stop */
    }
    if (command->fresh_mode) {
        command->mode = block->mode[i];
    }
    command->quick_stop = block->quick_stop[i] != 0U;
    command->clear_faults = (marks->axes[LATCH_CLEAR_FAULTS] & bit) != 0U && block->clear_faults[i] == 1U;
    block->clear_faults[i] = 0;

    bool clipped = false;
    command->position = clip(block->position[i], CMD_POSITION_MIN, CMD_POSITION_MAX, &clipped);
    command->speed = clip(block->speed[i], CMD_SPEED_MIN, CMD_SPEED_MAX, &clipped);
    command->i_q = (frac16_t)clip(block->i_q[i], CMD_I_Q_MIN, CMD_I_Q_MAX, &clipped);
    command->clipped = clipped;
}

/* A category that there is none of changes nothing. */
static stop_category_t category(uint16_t written, stop_category_t before)
{
    return (written <= STOP_CATEGORY_HOLD) ? (stop_category_t)written : before;
}

static void apply_parameter(const parameter_block_t *parameter, axis_t *axis)
{
    const uint16_t i = axis->index;
    bool clipped = false;
    const axis_limits_t limits = {
        clip(parameter->speed_limit[i], PARAM_SPEED_LIMIT_MIN, PARAM_SPEED_LIMIT_MAX, &clipped),
        clip(parameter->acceleration_limit[i], PARAM_ACCELERATION_LIMIT_MIN, PARAM_ACCELERATION_LIMIT_MAX, &clipped),
        (frac16_t)clip(parameter->i_q_limit[i], PARAM_I_Q_LIMIT_MIN, PARAM_I_Q_LIMIT_MAX, &clipped),
        clip(parameter->position_min[i], PARAM_POSITION_MIN_MIN, PARAM_POSITION_MIN_MAX, &clipped),
        clip(parameter->position_max[i], PARAM_POSITION_MAX_MIN, PARAM_POSITION_MAX_MAX, &clipped),
        clip(parameter->following_error[i], PARAM_FOLLOWING_ERROR_MIN, PARAM_FOLLOWING_ERROR_MAX, &clipped),
        clip(parameter->over_speed[i], PARAM_OVER_SPEED_MIN, PARAM_OVER_SPEED_MAX, &clipped),
    };
    motion_limit(axis, limits);
    axis->features = parameter->features[i];
    axis->feedback_wanted = parameter->feedback[i];
    axis->on_disable = category(parameter->on_disable[i], axis->on_disable);
    axis->on_quick_stop = category(parameter->on_quick_stop[i], axis->on_quick_stop);
    axis->faults_enabled = parameter->faults_enabled[i] | FAULTS_ALWAYS;
    axis->command.clipped = axis->command.clipped || clipped;
}

bool latch_apply(latch_marks_t *marks, command_block_t *block, const parameter_block_t *parameter, axis_t *axes)
{
    const bool any = marks->any;
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        apply_axis(marks, block, &axes[i]);
        apply_parameter(parameter, &axes[i]);
    }
    latch_reset(marks);
    return any;
}

void latch_skip(axis_t *axes)
{
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        axis_command_t *command = &axes[i].command;
        command->fresh_position = false;
        command->fresh_speed = false;
        command->fresh_i_q = false;
        command->fresh_mode = false;
        command->fresh_enable = false;
        command->fresh_quick_stop = false;
        command->clear_faults = false;
    }
}
