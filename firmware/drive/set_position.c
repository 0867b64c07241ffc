#include "drive/set_position.h"

#include "drive/ripple_forward.h"

static void add(int32_t *position, int32_t counts) { *position = i32_add_wrap(*position, counts); }

static bool holds(const axis_t *axis)
{
    const motion_state_t *m = &axis->motion;
    const trajectory_t *t = &axis->trajectory;
    return m->motion == MOTION_POSITION && path_filter_at_rest(&m->path, m->target) && !t->active &&
           trajectory_waiting(t) == 0U;
}

bool set_position_permitted(const axis_t *axis)
{
    const bool runs = axis->sm.state == STATE_RUN;
    if (runs && (axis->substate == SUBSTATE_SPIN || axis->substate == SUBSTATE_ALIGN)) {
        return axis->substate == SUBSTATE_SPIN && holds(axis);
    }
    return f32_abs(axis->feedback.speed) <= axis->config->stop_speed;
}

void set_position_shift(axis_t *axis, int32_t counts)
{
    motion_state_t *m = &axis->motion;
    ripple_forward_restart(axis);
    add(&axis->encoder.position.whole, counts);
    axis->encoder.found = true; /* preserved by the next rotor search */
    add(&axis->encoder.observer.count, counts);
    add(&axis->feedback.position, counts);
    add(&m->target, counts);
    m->path.ramp += path_counts(counts);
    m->path.output += path_counts(counts);
    m->model_position += path_counts(counts);
}
