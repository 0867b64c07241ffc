#include "drive/trajectory.h"

#include <stddef.h>

#define SLOW_PERIODS 8U

static bool earlier(uint32_t a, uint32_t b) { return (int32_t)(a - b) < 0; }

static const trajectory_point_t *at(const trajectory_t *t, uint16_t index)
{
    return &t->point[index % TRAJECTORY_POINTS];
}

void trajectory_clear(trajectory_t *t)
{
    t->out = t->in;
    t->active = false;
}

void trajectory_put(trajectory_t *t, trajectory_point_t point, bool replace)
{
    if (replace) {
        while (t->in != t->out && !earlier(at(t, (uint16_t)(t->in - 1U))->tick, point.tick)) {
            t->in--;
        }
        t->active = t->active && earlier(t->end.tick, point.tick);
    }
    t->point[t->in % TRAJECTORY_POINTS] = point;
    t->in++;
    t->taken++;
}

const trajectory_point_t *trajectory_before(const trajectory_t *t, uint32_t tick)
{
    for (uint16_t index = t->in; index != t->out; index--) {
        const trajectory_point_t *point = at(t, (uint16_t)(index - 1U));
        if (earlier(point->tick, tick)) {
            return point;
        }
    }
    return (t->active && earlier(t->end.tick, tick)) ? &t->end : NULL;
}

path_position_t trajectory_position(const trajectory_point_t *point, path_position_t near)
{
    const path_position_t part = (path_position_t)point->part << (PATH_BITS - TRAJECTORY_PART_BITS);
    return near - path_beyond(near, point->position) + part;
}

/* Start a segment to the next point that can still be reached in time. A point is late if it has been queued for longer
 * than its lead time. */
static void set_out(trajectory_t *t, const axis_config_t *config, hermite_state_t from, uint32_t begin, frac16_t i_q)
{
    while (t->in != t->out) {
        t->end = *at(t, t->out);
        t->out++;
        const bool late = earlier(t->end.tick, begin + HERMITE_DURATION_MIN);
        t->late = (uint16_t)(t->late + (late ? 1 : 0));
        if (!late) {
            const hermite_state_t to = {trajectory_position(&t->end, from.position),
                                        path_step_of(config, t->end.speed)};
            hermite_set(&t->segment, from, to, t->end.tick - begin);
            t->begin = begin;
            t->i_q_begin = i_q;
            t->end_position = to.position;
            t->active = true;
            return;
        }
    }
}

void trajectory_step(trajectory_t *t, const axis_config_t *config, hermite_state_t present, uint32_t tick)
{
    trajectory_reference_t *reference = &t->reference;
    reference->over = false;
    if (!t->active) {
        set_out(t, config, present, tick - SLOW_PERIODS, 0);
    } else if (!earlier(tick, t->end.tick)) {
        const hermite_state_t from = {t->end_position, path_step_of(config, t->end.speed)};
        t->active = false;
        set_out(t, config, from, t->end.tick, t->end.i_q);
        if (!t->active) {
            t->active = true; /* until the caller has handled the end */
            *reference = (trajectory_reference_t){t->end_position, 0, true};
            return;
        }
    }
    if (t->active) {
        const uint32_t elapsed = tick - t->begin;
        const int32_t change = (int32_t)t->end.i_q - t->i_q_begin;
        const int32_t part = (int32_t)(hermite_part(&t->segment, elapsed) >> 16);
        reference->position = hermite_position(&t->segment, elapsed);
        reference->i_q = (frac16_t)(t->i_q_begin + asr32(change * part, 14));
    }
}
