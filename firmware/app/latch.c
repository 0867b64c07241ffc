#include "app/latch.h"

#include "app/points.h"
#include "drive/holding_brake.h"
#include "drive/homing.h"
#include "drive/limits.h"
#include "drive/test_signal.h"

#include <stddef.h>

typedef struct {
    uint16_t offset;
    uint16_t element;
    uint16_t fresh;
} field_t;

#define FIELD(name, fresh)                                                                                             \
    {(uint16_t)offsetof(command_block_t, name), (uint16_t)sizeof(((command_block_t *)0)->name[0]), fresh}

static const field_t fields[] = {
    FIELD(position, FRESH_POSITION),
    FIELD(speed, FRESH_SPEED),
    FIELD(i_q, FRESH_I_Q),
    FIELD(mode, FRESH_MODE),
    FIELD(enable, FRESH_ENABLE),
    FIELD(quick_stop, FRESH_QUICK_STOP),
    FIELD(clear_faults, FRESH_CLEAR_FAULTS),
    FIELD(home, FRESH_HOME),
    FIELD(test_point, FRESH_TEST),
    FIELD(home_position, 0), /* counts as a command; latched only after the previous one */
};
#define FIELDS (sizeof fields / sizeof fields[0])

void latch_reset(latch_marks_t *marks) { *marks = (latch_marks_t){0}; }

void latch_mark(latch_marks_t *marks, uint16_t offset, uint16_t size)
{
    if (offset == offsetof(command_block_t, memory)) {
        marks->points = (uint16_t)(size / (4U * POINT_WORDS));
        marks->commands = true;
        return;
    }
    for (uint16_t k = 0; k < FIELDS; k++) {
        const field_t *field = &fields[k];
        for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
            const uint32_t begin = field->offset + (uint32_t)axis * field->element;
            if (offset < begin + field->element && begin < (uint32_t)offset + size) {
                marks->fresh[axis] = (uint16_t)(marks->fresh[axis] | field->fresh);
                marks->commands = true;
            }
        }
    }
}

static void apply_command(uint16_t fresh, command_block_t *block, axis_t *axis)
{
    const uint16_t i = axis->index;
    axis_command_t *command = &axis->command;
    command->enable = block->enable[i] == 1U;
    if ((fresh & FRESH_ENABLE) != 0U && command->enable && (fresh & FRESH_QUICK_STOP) == 0U) {
        block->quick_stop[i] = 0; /* a later enable command releases the quick stop */
    }
    if ((fresh & FRESH_MODE) != 0U) {
        axis->events.mode = (command->mode != block->mode[i]) ? EVENT_TICKS : axis->events.mode;
        command->mode = block->mode[i];
    }
    command->quick_stop = block->quick_stop[i] != 0U;
    if (block->clear_faults[i] == 0U) {
        fresh = (uint16_t)(fresh & (uint16_t)~FRESH_CLEAR_FAULTS);
    }
    block->clear_faults[i] = 0;

    fresh = homing_filter(axis, fresh, block->position[i]);
    if ((fresh & FRESH_HOME) != 0U) {
        homing_request(axis, block->home[i], block->home_position[i]);
        block->home[i] = HOME_METHOD_NONE;
    }

    if ((fresh & FRESH_TEST) != 0U) {
        const swept_sine_t sine = {
            .amplitude = block->test_amplitude[i],
            .step = block->test_step[i],
            .growth = block->test_growth[i],
            .calls = block->test_calls[i],
        };
        test_signal_start(axis, block->test_point[i], &sine);
        block->test_point[i] = TEST_POINT_NONE;
    }

    command->position = block->position[i];
    command->speed = block->speed[i];
    command->i_q = block->i_q[i];
    command->fresh = fresh;
}

/* No motion against a closed brake: set-points are deferred while the brake opens, unless another command arrives
 * meanwhile. */
static uint16_t deferred(const axis_t *axis, const command_block_t *block, uint16_t fresh)
{
    const uint16_t i = axis->index;
    const bool opening = axis->sm.state == STATE_RUN && axis->substate == SUBSTATE_SPIN && !holding_brake_is_open(axis);
    const bool requested = ((fresh & FRESH_ENABLE) != 0U) ? block->enable[i] == 1U : axis->enable_requested;
    const bool stopped = (fresh & FRESH_QUICK_STOP) != 0U && block->quick_stop[i] != 0U;
    return (opening && requested && !stopped) ? (uint16_t)(fresh & FRESH_MOTION) : 0U;
}

static void apply_parameters(const parameter_block_t *block, axis_t *axis)
{
    axis_parameters_t *parameter = &axis->parameter;
    parameters_of_axis(parameter, block, axis->index);
    const bool confined = (parameter->features & FEATURE_POSITION_LIMITS) != 0U;
    axis->written_limits = (axis_limits_t){
        parameter->speed_limit,
        parameter->acceleration_limit,
        parameter->i_q_limit,
        confined ? parameter->position_min : INT32_MIN,
        confined ? parameter->position_max : INT32_MAX,
    };
    homing_confine(axis, &axis->written_limits);
    axis->limits_fresh = true;
    axis->command_timeout = block->command_timeout;
    axis->latch.enabled = parameter->faults_enabled | FAULTS_ALWAYS;
}

bool latch_apply(latch_marks_t *marks, command_block_t *block, const parameter_block_t *parameter, axis_t *axes)
{
    const latch_marks_t written = *marks;
    latch_reset(marks);
    const uint16_t queued = points_queue(axes, block, written.points);
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        if (written.fresh[i] != 0U || (queued >> i & 1U) != 0U) {
            axes[i].events.command = EVENT_TICKS;
        }
        if (written.fresh[i] != 0U) {
            marks->fresh[i] = deferred(&axes[i], block, written.fresh[i]);
            apply_command((uint16_t)(written.fresh[i] & (uint16_t)~marks->fresh[i]), block, &axes[i]);
        }
        if ((queued >> i & 1U) != 0U) {
            axes[i].command.fresh = (uint16_t)(axes[i].command.fresh | FRESH_POINTS);
        }
        if (written.parameters != 0U) {
            apply_parameters(parameter, &axes[i]);
        }
        if (axes[i].home.limits_stale) {
            apply_parameters(parameter, &axes[i]);
            limits_renew(&axes[i]); /* no command needed: no motion beyond the old limits is in progress */
            axes[i].home.limits_stale = false;
        }
    }
    return written.commands || (written.parameters & PARAMETERS_WRITTEN) != 0U;
}
