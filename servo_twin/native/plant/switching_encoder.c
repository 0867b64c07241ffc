#include "plant/switching_encoder.h"

#define RESERVE 4u /* edges by which jitter, duty error and hysteresis may add to those of the shaft's motion */
/* Edges are predicted as far ahead as a linear interval may last [s]. */
#define EDGE_HORIZON (LINEAR_INTERVAL_MAX + SWITCHING_HORIZON * CLOCK)
#define GLITCH 100u /* duration of a disturbance [clocks] */
#define SLIP 100u /* from edge to edge of a slipping disc [clocks] */

/* ---- prediction ------------------------------------------------------------------------------------------------------- */

/* The next edge, later than `last`. */
static inline void find_edge(switching_axis_t *axis, uint64_t last)
{
    axis->edge_clock = NEVER;
    const double target = quadrature_target(&axis->encoder);
    if (target > axis->inverter.stop_max || target < axis->inverter.stop_min) {
        return; /* beyond an end stop */
    }
    /* An edge whose jitter put it behind the shaft is passed at once, however far the shaft has moved since. */
    const double distance = target - axis->trajectory.theta;
    if ((axis->encoder.upwards ? distance : -distance) > axis->trajectory.range) {
        return;
    }
    const double t = quadrature_time(&axis->encoder, &axis->trajectory) - axis->trajectory_time;
    if (t < EDGE_HORIZON) {
        axis->edge_clock = clock_after(axis->trajectory_clock, (t > 0.0) ? t : 0.0, last);
    }
}

/* Defer all edges of a trajectory, or none. */
static inline void update_deferral(switching_axis_t *axis)
{
    const double edges = (axis->deferrable_edges > RESERVE) ? (double)(axis->deferrable_edges - RESERVE) : 0.0;
    axis->defers = axis->trajectory.range < edges * axis->encoder.pitch;
    axis->report_clock = axis->defers ? NEVER : axis->edge_clock;
}

void switching_update_trajectory(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    const switched_inverter_t *inv = &axis->inverter;
    switching_pass_deferred(plant, i);
    axis->trajectory =
        quadrature_trajectory(&axis->encoder, inv->theta, inv->omega, inv->accel, inv->jerk, EDGE_HORIZON);
    axis->trajectory_clock = axis->clock;
    axis->trajectory_time = inv->interval.elapsed;
    find_edge(axis, plant->now);
    update_deferral(axis);
}

/* ---- edges ------------------------------------------------------------------------------------------------------------ */

static void report_line(switching_t *plant, int i, int line, bool level)
{
    queue_event(plant, (switching_event_t){plant->now, SWITCHING_ENCODER, (uint8_t)i, (uint8_t)line, level});
    plant->axis[i].deferrable_edges -= (plant->axis[i].deferrable_edges > 0u) ? 1u : 0u;
}

void switching_pass_edge(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    const quadrature_edge_t edge = quadrature_pass(&axis->encoder);
    if (edge.seen) {
        report_line(plant, i, edge.line, edge.level);
    }
    find_edge(axis, plant->now);
    axis->report_clock = axis->edge_clock;
    update_axis_clock(axis);
}

void switching_pass_deferred(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    while (axis->defers && axis->edge_clock <= plant->now && axis->deferrable_edges > 0u) {
        const uint64_t clock = axis->edge_clock;
        const quadrature_edge_t edge = quadrature_pass(&axis->encoder);
        if (edge.seen) {
            axis->deferred[axis->deferred_count++] =
                (switching_event_t){clock, SWITCHING_ENCODER, (uint8_t)i, edge.line, edge.level};
            axis->deferrable_edges--;
        }
        find_edge(axis, clock);
    }
}

void switching_defer_edges(switching_t *plant, int i, unsigned edges)
{
    switching_axis_t *axis = &plant->axis[i];
    switching_pass_deferred(plant, i);
    const unsigned room = SWITCHING_DEFERRED_MAX - axis->deferred_count;
    const unsigned allowed = (edges < room) ? edges : room;
    axis->deferrable_edges =
        (allowed > plant->pending) ? allowed - plant->pending : 0u; /* queued events may be edges, too */
    update_deferral(axis);
    update_axis_clock(axis);
    if (!plant->stale) {
        update_next(plant);
    }
}

bool switching_take_deferred(switching_t *plant, int i, switching_event_t *event)
{
    switching_axis_t *axis = &plant->axis[i];
    switching_pass_deferred(plant, i);
    if (axis->deferred_first == axis->deferred_count) {
        axis->deferred_first = axis->deferred_count = 0;
        return false;
    }
    *event = axis->deferred[axis->deferred_first++];
    return true;
}

/* ---- changes without motion of the shaft ------------------------------------------------------------------------------ */

void switching_update_line(switching_t *plant, int i, int line, bool before)
{
    switching_axis_t *axis = &plant->axis[i];
    const bool after = quadrature_level(&axis->encoder, line);
    if (after != before) {
        report_line(plant, i, line, after);
        update_deferral(axis);
        update_axis_clock(axis);
        plant->stale = true;
    }
}

/* Uniformly distributed from the end of a disturbance to twice the mean. */
void switching_schedule_glitch(switching_t *plant, int i, int line)
{
    switching_axis_t *axis = &plant->axis[i];
    plant_faults_t *faults = &axis->faults;
    axis->glitch_clock[line] =
        (faults->glitches[line] > 0.0)
            ? plant->now + GLITCH +
                  (uint64_t)(2.0 * SWITCHING_CLOCK_HZ / faults->glitches[line] * plant_faults_uniform(faults))
            : NEVER;
}

void switching_toggle_glitch(switching_t *plant, int i, int line)
{
    switching_axis_t *axis = &plant->axis[i];
    switching_pass_deferred(plant, i);
    const bool before = quadrature_level(&axis->encoder, line);
    bool *flipped = &axis->encoder.flipped[line];
    *flipped = !*flipped;
    switching_update_line(plant, i, line, before);
    if (*flipped) {
        axis->glitch_clock[line] = plant->now + GLITCH;
    } else {
        switching_schedule_glitch(plant, i, line);
    }
}

void switching_start_slip(switching_t *plant, int i, int32_t edges)
{
    switching_axis_t *axis = &plant->axis[i];
    axis->slip += edges;
    axis->slip_clock = (axis->slip != 0) ? plant->now + SLIP : NEVER;
}

void switching_slip(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    switching_pass_deferred(plant, i);
    const bool upwards = axis->slip > 0;
    const int line = ((axis->encoder.position + upwards) & 1) == 0;
    const bool before = quadrature_level(&axis->encoder, line);
    quadrature_slip(&axis->encoder, upwards);
    switching_update_line(plant, i, line, before);
    switching_start_slip(plant, i, upwards ? -1 : 1);
}
