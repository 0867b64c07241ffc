#include "plant/switching.h"

#include <math.h>
#include <string.h>

#include "plant/inline.h"
#include "plant/trig.h"

#define CLOCK (1.0 / SWITCHING_CLOCK_HZ) /* [s] */
#define SHAFT (SWITCHING_SHAFT * CLOCK) /* [s] */
#define NEVER UINT64_MAX
#define SPREAD 4u /* edges by which jitter, duty error and hysteresis may add to the way of the shaft */
/* Edges are looked for as far ahead as a frame may last [s]. */
#define EDGE_HORIZON (LINEAR_INTERVAL_MAX + SWITCHING_HORIZON * CLOCK)
#define THERMAL_WINDOWS 16u /* from one step of the temperatures to the next */
#define GLITCH 100u /* a disturbance of an encoder line lasts so long [clocks] */
#define SLIP 100u /* from edge to edge of a disc that slips [clocks] */

static void find_other_events(switching_t *plant);

static double seconds(uint64_t from, uint64_t to) { return (double)(int64_t)(to - from) * CLOCK; }

/* On the second mass, where there is one; the next step adds what stops, shaft and cogging take. */
static void set_load(switching_t *plant, int i, double torque)
{
    shaft_t *shaft = &plant->shaft[i];
    shaft->load = plant->parameters[i].load_torque = torque;
    plant->stop[i].load = shaft->two_masses ? 0.0 : torque;
    plant->axis[i].inverter.load = plant->stop[i].load + (shaft->two_masses ? shaft->torque : 0.0);
}

/* What the configuration says of the sensors, the switches and the end stops of an axis. */
static void set_axis(switching_t *plant, int i, const board_config_t *config)
{
    const plant_axis_t *c = &config->axis[i];
    switching_axis_t *axis = &plant->axis[i];
    const double l = (c->l_d < c->l_q) ? c->l_d : c->l_q;
    plant->parameters[i] = *c;
    shaft_change(&plant->shaft[i], c, axis->inverter.theta, axis->inverter.omega);
    plant->stop[i] = end_stop_of(c, plant->shaft[i].fine ? SHAFT : 1.0 / config->pwm_frequency);
    set_load(plant, i, c->load_torque);
    axis->dead_time_min = (uint64_t)(c->dead_time_min * SWITCHING_CLOCK_HZ + 0.5);
    axis->i_break = c->i_break;
    axis->square_break = c->i_break * c->i_break;
    const double far = c->i_break - 2.0 * config->bus.u_source / l * SWITCHING_HORIZON * CLOCK;
    axis->square_far = (far > 0.0) ? far * far : 0.0;
    axis->codes_per_ampere = 2048.0 / c->i_full_scale;
    memcpy(axis->i_offset, c->i_offset, sizeof axis->i_offset);
    axis->r_s = c->r_s;
}

static void set_bus(switching_t *plant, const plant_bus_t *bus)
{
    plant->u_noise = plant_faults_noise(&plant->u_noise_configured, plant->u_noise, bus->u_noise);
    plant->codes_per_volt = 4096.0 / bus->u_full_scale;
}

void switching_init(switching_t *plant, const board_config_t *config)
{
    memset(plant, 0, sizeof *plant);
    plant->stale = true;
    supply_init(&plant->supply, &config->bus, config->ambient);
    set_bus(plant, &config->bus);
    plant_random_init(&plant->noise, config->seed, 0);
    plant->window = (uint64_t)(SWITCHING_CLOCK_HZ / config->pwm_frequency + 0.5);
    plant->window_clock = plant->window;
    plant->other_clock = plant->window;
    plant->shaft_clock = NEVER;
    for (int i = 0; i < BOARD_AXES; i++) {
        const plant_axis_t *c = &config->axis[i];
        switching_axis_t *axis = &plant->axis[i];
        switched_inverter_init(&axis->inverter, c);
        set_axis(plant, i, config);
        axis->window = switched_inverter_integral(&axis->inverter);
        quadrature_init(&axis->encoder, c, config->seed, (uint64_t)i + 3u);
        thermal_init(&axis->winding, c->winding_capacity, c->winding_resistance, config->ambient);
        thermal_init(&axis->sink, c->sink_capacity, c->sink_resistance, config->ambient);
        plant_random_init(&axis->noise, config->seed, (uint64_t)i + 1u);
        plant_faults_init(&axis->faults, c, config->seed, (uint64_t)i + 5u);
        for (int line = 0; line < QUADRATURE_LINES; line++) {
            axis->glitch_clock[line] = NEVER;
        }
        axis->slip_clock = NEVER;
        axis->shown_clock = NEVER;
        axis->i_noise = c->i_noise;
        plant->t_magnet[i] = config->ambient;
    }
    find_other_events(plant);
}

/* ---- events ------------------------------------------------------------------------------------------------------- */

static inline void report(switching_t *plant, switching_event_t event)
{
    if (plant->pending < SWITCHING_EVENTS) {
        plant->event[(plant->first + plant->pending++) % SWITCHING_EVENTS] = event;
    }
}

bool switching_take(switching_t *plant, switching_event_t *event)
{
    if (plant->pending == 0u) {
        return false;
    }
    *event = plant->event[plant->first];
    plant->first = (plant->first + 1u) % SWITCHING_EVENTS;
    plant->pending--;
    return true;
}

/* ---- looking ahead ------------------------------------------------------------------------------------------------ */

static uint64_t earlier(uint64_t x, uint64_t y) { return (x < y) ? x : y; }

/* Clock at or after a time counted from `clock`, and behind another one. */
static inline uint64_t clock_after(uint64_t clock, double time, uint64_t last)
{
    const uint64_t at = clock + (uint64_t)(int64_t)(time * SWITCHING_CLOCK_HZ) + 1u;
    return (at > last) ? at : last + 1u;
}

/* Straight on, when does a current reach the comparator's threshold, from either side? */
static uint64_t trip_time(const switching_t *plant, const switching_axis_t *axis)
{
    const switched_inverter_t *inv = &axis->inverter;
    const double side = 0.5 * PLANT_SQRT3 * inv->di.beta;
    const double slope[3] = {inv->di.alpha, -0.5 * inv->di.alpha + side, -0.5 * inv->di.alpha - side};
    double soonest = SWITCHING_HORIZON * CLOCK;
    for (int k = 0; k < 3; k++) {
        const double size = fabs(inv->phase[k]);
        const double grows = (inv->phase[k] > 0.0) ? slope[k] : -slope[k];
        const double t = (axis->i_break - size) / grows;
        if (t >= 0.0 && t < soonest) {
            soonest = t;
        }
    }
    return (soonest < SWITCHING_HORIZON * CLOCK) ? clock_after(axis->clock, soonest, plant->now) : NEVER;
}

/* The next edge of the encoder, behind `last`. */
static inline void find_edge(switching_axis_t *axis, uint64_t last)
{
    axis->edge_clock = NEVER;
    const double target = quadrature_target(&axis->encoder);
    if (target > axis->inverter.stop_max || target < axis->inverter.stop_min) {
        return; /* beyond an end stop */
    }
    /* An edge drawn on the other side of the shaft is behind it, however far it has gone since: that is passed at once. */
    const double way = target - axis->trajectory.theta;
    if ((axis->encoder.upwards ? way : -way) > axis->trajectory.range) {
        return;
    }
    const double t = quadrature_time(&axis->encoder, &axis->trajectory) - axis->trajectory_time;
    if (t < EDGE_HORIZON) {
        axis->edge_clock = clock_after(axis->trajectory_clock, (t > 0.0) ? t : 0.0, last);
    }
}

/* Whether the edges of a course may be kept back: all of them, or none. */
static inline void find_deferral(switching_axis_t *axis)
{
    const double edges = (axis->deferrable_edges > SPREAD) ? (double)(axis->deferrable_edges - SPREAD) : 0.0;
    axis->defers = axis->trajectory.range < edges * axis->encoder.pitch;
    axis->report_clock = axis->defers ? NEVER : axis->edge_clock;
}

static inline void find_next(switching_axis_t *axis)
{
    axis->next_clock = earlier(earlier(axis->report_clock, axis->trip_clock), axis->clock + SWITCHING_HORIZON);
}

static inline void find_next_of_all(switching_t *plant)
{
    plant->next = earlier(plant->other_clock, earlier(plant->axis[0].next_clock, plant->axis[1].next_clock));
}

static void find_other_events(switching_t *plant)
{
    plant->other_clock = plant->window_clock;
    if (!plant->shaft[0].fine && !plant->shaft[1].fine) {
        plant->shaft_clock = NEVER;
    } else if (plant->shaft_clock == NEVER) {
        plant->shaft_clock = plant->now + 1u;
    }
    plant->other_clock = earlier(plant->other_clock, plant->shaft_clock);
    for (int i = 0; i < BOARD_AXES; i++) {
        if (plant->axis[i].short_clock > plant->now) {
            plant->other_clock = earlier(plant->other_clock, plant->axis[i].short_clock);
        }
        for (int line = 0; line < QUADRATURE_LINES; line++) {
            plant->other_clock = earlier(plant->other_clock, plant->axis[i].glitch_clock[line]);
        }
        plant->other_clock = earlier(plant->other_clock, plant->axis[i].slip_clock);
    }
}

/* Of the current vector [A^2]. */
static inline double square_of(const switching_axis_t *axis)
{
    const plant_vector_t current = axis->inverter.i;
    return current.alpha * current.alpha + current.beta * current.beta;
}

/* What an axis draws from the bus in the segment that has begun. */
static inline void draw(switching_t *plant, int i)
{
    plant->i_bus[i] = switched_inverter_bus_current(&plant->axis[i].inverter);
    plant->di_bus[i] = switched_inverter_bus_current_slope(&plant->axis[i].inverter);
}

/* Edges that are kept back happen up to the present clock, while the shaft's course is still known. */
static inline void pass_deferred(switching_t *plant, int i)
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

/* What follows from the segment of an axis that has begun at the present clock, with this square of the current. */
static inline void after_new_segment(switching_t *plant, int i, double square)
{
    switching_axis_t *axis = &plant->axis[i];
    switched_inverter_t *inv = &axis->inverter;
    draw(plant, i);
    if (inv->trajectory_changed) {
        inv->trajectory_changed = false;
        pass_deferred(plant, i);
        axis->trajectory =
            quadrature_trajectory(&axis->encoder, inv->theta, inv->omega, inv->accel, inv->jerk, EDGE_HORIZON);
        axis->trajectory_clock = axis->clock;
        axis->trajectory_time = inv->interval.elapsed;
        find_edge(axis, plant->now);
        find_deferral(axis);
    }
    axis->trip_clock = (square < axis->square_far) ? NEVER : trip_time(plant, axis);
    find_next(axis);
}

/* After whatever has changed at the present clock. */
void switching_find_next_event(switching_t *plant)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        if (!plant->axis[i].inverter.segment_valid) {
            switched_inverter_begin(&plant->axis[i].inverter, plant->supply.u);
            after_new_segment(plant, i, square_of(&plant->axis[i]));
        }
    }
    find_next_of_all(plant);
    plant->stale = false;
}

/* ---- moving on ---------------------------------------------------------------------------------------------------- */

/* The bus to the present clock, with the currents of both axes extrapolated along their slopes. */
PLANT_INLINE void move_supply(switching_t *plant)
{
    const uint64_t from = plant->supply_clock;
    if (plant->now == from) {
        return;
    }
    const double h = seconds(from, plant->now);
    const double load = (plant->i_bus[0] + plant->i_bus[1]) + h * (0.5 * (plant->di_bus[0] + plant->di_bus[1]));
    for (int i = 0; i < BOARD_AXES; i++) {
        const double rise = h * plant->di_bus[i];
        plant->charge_booked[i] += h * (plant->i_bus[i] + 0.5 * rise);
        plant->i_bus[i] += rise;
    }
    const supply_step_t step = supply_step_of(&plant->supply, h);
    const double u_h = supply_take_step(&plant->supply, &step, load);
    for (int i = 0; i < BOARD_AXES; i++) {
        plant->u_h[i] += u_h;
    }
    plant->supply_clock = plant->now;
}

/* The same for who comes seldom. */
static void advance_supply(switching_t *plant) { move_supply(plant); }

/* Output of the comparator. */
static void compare(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    const double *p = axis->inverter.phase;
    const double most = axis->i_break;
    const bool tripped = p[0] > most || p[1] > most || p[2] > most || p[0] < -most || p[1] < -most || p[2] < -most ||
                         axis->short_clock > plant->now;
    if (tripped != axis->tripped) {
        axis->tripped = tripped;
        report(plant, (switching_event_t){plant->now, SWITCHING_OVER_CURRENT, (uint8_t)i, 0, tripped});
    }
}

/* One axis to the present clock; `square` is that of the current there. Returns the voltage that the bus was expected to
 * have: what it really has takes longer to find out, and makes no difference to the slopes of a segment. */
PLANT_INLINE double move_axis(switching_t *plant, int i, double *square)
{
    switching_axis_t *axis = &plant->axis[i];
    const double h = seconds(axis->clock, plant->now);
    const double per_h = 1.0 / h; /* ready when the voltage is */
    move_supply(plant);
    const double u = plant->supply.u;
    const double charge = switched_inverter_advance(&axis->inverter, h, plant->u_h[i] * per_h);
    supply_take(&plant->supply, charge - plant->charge_booked[i]);
    plant->charge_booked[i] = 0.0;
    plant->u_h[i] = 0.0;
    axis->clock = plant->now;
    axis->shown_clock = NEVER;
    *square = square_of(axis);
    if (axis->tripped || *square > axis->square_break) {
        compare(plant, i);
    }
    return u;
}

static void advance_axis(switching_t *plant, int i)
{
    if (plant->axis[i].clock != plant->now) {
        double square;
        (void)move_axis(plant, i, &square);
        plant->stale = true;
    }
}

/* Flux of the magnet as warm as it is. */
static double magnet(const switching_t *plant, int i)
{
    const plant_axis_t *c = &plant->parameters[i];
    return c->psi_m * (1.0 + c->magnet_coefficient * (plant->t_magnet[i] - plant->axis[i].winding.ambient));
}

static void warm_up(switching_t *plant)
{
    const double h = (double)(THERMAL_WINDOWS * plant->window) * CLOCK;
    for (int i = 0; i < BOARD_AXES; i++) {
        switching_axis_t *axis = &plant->axis[i];
        switched_inverter_t *inv = &axis->inverter;
        switched_inverter_sync(inv);
        plant->stale = true;
        thermal_advance(&axis->winding, h, inv->e_copper - axis->e_copper);
        if (!axis->faults.sink_held) {
            thermal_advance(&axis->sink, h, inv->e_switch - axis->e_switch);
        }
        axis->e_copper = inv->e_copper;
        axis->e_switch = inv->e_switch;
        switched_inverter_set_winding(inv, axis->r_s * thermal_copper(&axis->winding));
        plant->t_magnet[i] +=
            thermal_magnet(h, plant->parameters[i].magnet_time) * (axis->winding.t - plant->t_magnet[i]);
        if (plant->parameters[i].magnet_coefficient != 0.0) {
            switched_inverter_set_magnet(inv, magnet(plant, i));
            inv->trajectory_changed = true;
        }
    }
    supply_warm(&plant->supply, h);
}

/* What end stops, shaft and cogging do to a rotor until the next time. */
static void push_back(switching_t *plant, int i)
{
    switched_inverter_t *inv = &plant->axis[i].inverter;
    switched_inverter_sync(inv);
    inv->load = end_stop_load(&plant->stop[i], inv->theta, inv->omega);
    if (plant->shaft[i].fine) {
        inv->load += shaft_step(&plant->shaft[i], inv->theta, inv->omega, SHAFT);
    }
    inv->segment_valid = false;
    inv->trajectory_changed = true;
    plant->stale = true;
}

/* The next step of the shafts that take short ones. */
static void step_shafts(switching_t *plant)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        if (plant->shaft[i].fine) {
            advance_axis(plant, i);
            push_back(plant, i);
        }
    }
    plant->shaft_clock += SWITCHING_SHAFT;
}

/* Whoever looks at the means must not change what comes after: the plant itself stops for them, always at these clocks. */
static void end_window(switching_t *plant)
{
    const double per_h = SWITCHING_CLOCK_HZ / (double)plant->window;
    for (int i = 0; i < BOARD_AXES; i++) {
        switching_axis_t *axis = &plant->axis[i];
        advance_axis(plant, i);
        const terminal_integral_t now = switched_inverter_integral(&axis->inverter);
        for (int k = 0; k < 3; k++) {
            axis->voltage[k] = (now.volts[k] - axis->window.volts[k]) * per_h;
        }
        if (plant->stop[i].stiffness > 0.0 && !plant->shaft[i].fine) {
            push_back(plant, i);
        }
    }
    if (++plant->windows == THERMAL_WINDOWS) {
        plant->windows = 0;
        warm_up(plant);
    }
    for (int i = 0; i < BOARD_AXES; i++) { /* with the new resistance */
        plant->axis[i].window = switched_inverter_integral(&plant->axis[i].inverter);
    }
    plant->window_clock += plant->window;
}

/* A line of an encoder changes, and somebody may wait for it. */
static void report_line(switching_t *plant, int i, int line, bool level)
{
    report(plant, (switching_event_t){plant->now, SWITCHING_ENCODER, (uint8_t)i, (uint8_t)line, level});
    plant->axis[i].deferrable_edges -= (plant->axis[i].deferrable_edges > 0u) ? 1u : 0u;
}

static inline void pass_edge(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    const quadrature_edge_t edge = quadrature_pass(&axis->encoder);
    if (edge.seen) {
        report_line(plant, i, edge.line, edge.level);
    }
    find_edge(axis, plant->now);
    axis->report_clock = axis->edge_clock;
    find_next(axis);
}

/* The shaft has had no part in this. */
static void set_line(switching_t *plant, int i, int line, bool before)
{
    switching_axis_t *axis = &plant->axis[i];
    const bool after = quadrature_level(&axis->encoder, line);
    if (after != before) {
        report_line(plant, i, line, after);
        find_deferral(axis);
        find_next(axis);
        plant->stale = true;
    }
}

/* When a line is disturbed next: any time up to twice the mean is as likely as any other. */
static uint64_t next_glitch(switching_t *plant, int i, int line)
{
    plant_faults_t *faults = &plant->axis[i].faults;
    if (faults->glitches[line] <= 0.0) {
        return NEVER;
    }
    return plant->now + GLITCH +
           (uint64_t)(2.0 * SWITCHING_CLOCK_HZ / faults->glitches[line] * plant_faults_uniform(faults));
}

/* A disturbance begins or ends. */
static void glitch(switching_t *plant, int i, int line)
{
    switching_axis_t *axis = &plant->axis[i];
    pass_deferred(plant, i);
    const bool before = quadrature_level(&axis->encoder, line);
    bool *flipped = &axis->encoder.flipped[line];
    *flipped = !*flipped;
    set_line(plant, i, line, before);
    axis->glitch_clock[line] = *flipped ? plant->now + GLITCH : next_glitch(plant, i, line);
}

/* An edge of a disc that turns on its shaft. */
static void slip(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    pass_deferred(plant, i);
    const bool upwards = axis->slip > 0;
    const int line = ((axis->encoder.position + upwards) & 1) == 0;
    const bool before = quadrature_level(&axis->encoder, line);
    quadrature_slip(&axis->encoder, upwards);
    set_line(plant, i, line, before);
    axis->slip -= upwards ? 1 : -1;
    axis->slip_clock = (axis->slip != 0) ? plant->now + SLIP : NEVER;
}

static void process_other_events(switching_t *plant)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        for (int line = 0; line < QUADRATURE_LINES; line++) {
            if (plant->axis[i].glitch_clock[line] == plant->now) {
                glitch(plant, i, line);
            }
        }
        if (plant->axis[i].slip_clock == plant->now) {
            slip(plant, i);
        }
        if (plant->axis[i].short_clock == plant->now) {
            compare(plant, i);
        }
    }
    if (plant->window_clock == plant->now) {
        end_window(plant);
    }
    if (plant->shaft_clock == plant->now) {
        step_shafts(plant);
    }
    find_other_events(plant);
}

void switching_process_event(switching_t *plant)
{
    plant->now = plant->next;
    for (int i = 0; i < BOARD_AXES; i++) {
        const switching_axis_t *axis = &plant->axis[i];
        if (axis->next_clock == plant->now) {
            if (axis->report_clock == plant->now) {
                pass_edge(plant, i);
            } else {
                advance_axis(plant, i);
            }
        }
    }
    if (plant->other_clock == plant->now) {
        process_other_events(plant);
    }
    if (!plant->stale) {
        find_next_of_all(plant);
    }
}

/* ---- edges that nobody waits for --------------------------------------------------------------------------------------- */

void switching_defer_edges(switching_t *plant, int i, unsigned edges)
{
    switching_axis_t *axis = &plant->axis[i];
    pass_deferred(plant, i);
    const unsigned room = SWITCHING_DEFERRED_MAX - axis->deferred_count;
    const unsigned most = (edges < room) ? edges : room;
    axis->deferrable_edges = (most > plant->pending) ? most - plant->pending : 0u; /* some of those may be edges, too */
    find_deferral(axis);
    find_next(axis);
    if (!plant->stale) {
        find_next_of_all(plant);
    }
}

bool switching_take_deferred(switching_t *plant, int i, switching_event_t *event)
{
    switching_axis_t *axis = &plant->axis[i];
    pass_deferred(plant, i);
    if (axis->deferred_first == axis->deferred_count) {
        axis->deferred_first = axis->deferred_count = 0;
        return false;
    }
    *event = axis->deferred[axis->deferred_first++];
    return true;
}

/* ---- gates -------------------------------------------------------------------------------------------------------- */

/* For the comparator: how a leg with both switches on carries the motor's current is not modelled. */
static void begin_short(switching_t *plant, int i, uint64_t until)
{
    plant->axis[i].short_clock = until;
    plant->stale = true;
    find_other_events(plant);
    compare(plant, i);
}

/* Both rails on a short in the motor's cable: one upper switch against bus minus, or against the other phase's lower one. */
static bool feeds_short(const switching_axis_t *axis)
{
    const switched_inverter_t *inv = &axis->inverter;
    if (inv->grounded >= 0) {
        return axis->leg[inv->grounded] == SWITCHING_HIGH;
    }
    if (inv->unshorted >= 0) {
        const switching_leg_t one = axis->leg[(inv->unshorted + 1) % 3];
        const switching_leg_t other = axis->leg[(inv->unshorted + 2) % 3];
        return (one == SWITCHING_HIGH && other == SWITCHING_LOW) || (one == SWITCHING_LOW && other == SWITCHING_HIGH);
    }
    return false;
}

static void watch_cable(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    const bool feeds = feeds_short(axis);
    if (feeds != axis->short_fed) {
        axis->short_fed = feeds;
        begin_short(plant, i, feeds ? NEVER : plant->now);
    }
}

/* Both switches of a leg are on, were so, or one closes soon after another: a short, if it is. */
static void watch_overlap(switching_t *plant, int i, int phase, switching_leg_t before, switching_leg_t leg)
{
    const switching_axis_t *axis = &plant->axis[i];
    if (before == SWITCHING_SHORT) {
        begin_short(plant, i, plant->now);
    }
    if (leg == SWITCHING_SHORT) {
        begin_short(plant, i, NEVER);
    } else if (leg != SWITCHING_OPEN && leg != axis->last_on[phase] && plant->now < axis->safe_clock[phase]) {
        begin_short(plant, i, axis->safe_clock[phase]);
    }
}

static inline void watch_short(switching_t *plant, int i, int phase, switching_leg_t leg)
{
    switching_axis_t *axis = &plant->axis[i];
    const switching_leg_t before = axis->leg[phase];
    axis->leg[phase] = leg;
    if (before == SWITCHING_HIGH || before == SWITCHING_LOW) {
        axis->safe_clock[phase] = plant->now + axis->dead_time_min;
        axis->last_on[phase] = before;
    }
    const bool soon = leg != SWITCHING_OPEN && plant->now < axis->safe_clock[phase];
    if (soon || before == SWITCHING_SHORT || leg == SWITCHING_SHORT) {
        watch_overlap(plant, i, phase, before, leg);
    }
    if (axis->inverter.shorted) {
        watch_cable(plant, i);
    }
}

/* The axis goes on with other gates. */
static inline void switch_over(switching_t *plant, int i, unsigned gates)
{
    switching_axis_t *axis = &plant->axis[i];
    switched_inverter_t *inv = &axis->inverter;
    double u = plant->supply.u;
    double square;
    if (axis->clock != plant->now) {
        u = move_axis(plant, i, &square);
    } else {
        switched_inverter_restart(inv); /* several legs switch at one clock */
        square = square_of(axis);
    }
    inv->gates = gates;
    switched_inverter_begin(inv, u);
    after_new_segment(plant, i, square);
    find_next_of_all(plant);
}

void switching_edge(switching_t *plant, int i, int phase, switching_leg_t leg)
{
    switching_axis_t *axis = &plant->axis[i];
    switched_inverter_t *inv = &axis->inverter;
    if (axis->leg[phase] == leg) {
        return;
    }
    const unsigned gates = switched_inverter_gates_with(inv, phase, leg);
    if (switched_inverter_edge_has_no_effect(inv, phase, gates, seconds(axis->clock, plant->now), plant->supply.u)) {
        inv->gates = gates;
    } else {
        switch_over(plant, i, gates);
    }
    watch_short(plant, i, phase, leg);
}

/* ---- pins --------------------------------------------------------------------------------------------------------- */

/* What the amplifiers show: both converters hold at one clock. */
static void amplify(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    switching_update_next_event(plant);
    if (!switched_inverter_amplifiers(&axis->inverter, seconds(axis->clock, plant->now), plant->supply.u,
                                      axis->shown)) {
        advance_axis(plant, i);
        switching_find_next_event(plant);
        memcpy(axis->shown, axis->inverter.amplifier, sizeof axis->shown);
    }
    axis->shown_clock = plant->now;
}

uint16_t switching_current_code(switching_t *plant, int i, int phase)
{
    switching_axis_t *axis = &plant->axis[i];
    if (axis->shown_clock != plant->now) {
        amplify(plant, i);
    }
    const double shown =
        axis->shown[INVERTER_LANE(phase)] + axis->i_offset[phase] + axis->i_noise * plant_random_gauss(&axis->noise);
    return plant_faults_code(&axis->faults, phase, plant_code(2048.0 + shown * axis->codes_per_ampere));
}

uint16_t switching_bus_code(switching_t *plant)
{
    switching_update_next_event(plant);
    advance_supply(plant);
    const double shown = plant->supply.u + plant->u_noise * plant_random_gauss(&plant->noise);
    return plant_code(shown * plant->codes_per_volt);
}

bool switching_over_current(const switching_t *plant, int axis) { return plant->axis[axis].tripped; }

bool switching_line(const switching_t *plant, int axis, int line)
{
    return quadrature_level(&plant->axis[axis].encoder, line);
}

/* ---- truth -------------------------------------------------------------------------------------------------------- */

/* Copy of the plant with the bus and one axis at the present clock. */
static switching_t here(const switching_t *plant, int axis)
{
    switching_t copy = *plant;
    switching_find_next_event(&copy);
    advance_supply(&copy);
    advance_axis(&copy, axis);
    switched_inverter_sync(&copy.axis[axis].inverter);
    return copy;
}

double switching_theta(const switching_t *plant, int i)
{
    const switching_axis_t *axis = &plant->axis[i];
    return axis->inverter.theta + axis->inverter.omega * seconds(axis->clock, plant->now);
}

void switching_truth(const switching_t *plant, int i, switching_truth_t *truth)
{
    switching_t copy = here(plant, i);
    switching_find_next_event(&copy);
    const switching_axis_t *axis = &copy.axis[i];
    const switched_inverter_t *inv = &axis->inverter;
    const shaft_t *shaft = &copy.shaft[i];
    const bool two = shaft->two_masses;
    const double rest = two ? seconds(copy.now, copy.shaft_clock) : 0.0;
    *truth = (switching_truth_t){
        .theta = inv->theta,
        .omega = inv->omega,
        .i_d = inv->i.alpha * inv->cosine + inv->i.beta * inv->sine,
        .i_q = inv->i.beta * inv->cosine - inv->i.alpha * inv->sine,
        .torque = inv->torque,
        .theta_load = two ? shaft->theta - rest * (shaft->omega - 0.5 * rest * shaft->accel) : inv->theta,
        .omega_load = two ? shaft->omega - rest * shaft->accel : inv->omega,
        .torque_shaft = two ? shaft->torque : 0.0,
        .t_magnet = copy.t_magnet[i],
        .r_s = inv->r_s,
        .psi_m = inv->psi_m,
        .l_d = 1.0 / (inv->inv_l_mean + inv->inv_l_half),
        .l_q = 1.0 / (inv->inv_l_mean - inv->inv_l_half),
        .t_winding = axis->winding.t,
        .t_sink = axis->sink.t,
        .e_bus = inv->e_bus,
        .e_copper = inv->e_copper,
        .e_switch = inv->e_switch,
        .over_current = axis->tripped,
    };
    for (int k = 0; k < 3; k++) {
        truth->voltage[k] = axis->voltage[k];
        truth->phase[k] = inv->phase[k];
        truth->shunt[k] = switched_inverter_shunt(inv, k);
        truth->amplifier[k] = inv->amplifier[INVERTER_LANE(k)];
    }
}

void switching_bus(const switching_t *plant, switching_bus_t *bus)
{
    switching_t copy = here(plant, 0);
    advance_axis(&copy, 1);
    bus->u_dc = copy.supply.u;
    bus->e_source = copy.supply.e_source;
    bus->e_brake = copy.supply.e_brake;
    bus->t_brake = copy.supply.brake.t;
}

/* ---- other hands on the plant ------------------------------------------------------------------------------------- */

/* The axis to the present clock, where something about it changes. */
static switched_inverter_t *touch(switching_t *plant, int i)
{
    switching_find_next_event(plant);
    switched_inverter_t *inverter = &plant->axis[i].inverter;
    pass_deferred(plant, i);
    advance_axis(plant, i);
    switched_inverter_sync(inverter);
    inverter->segment_valid = false;
    inverter->trajectory_changed = true;
    plant->stale = true;
    return inverter;
}

/* The disc turns by so many edges, one after another; the caller looks for the next rare event. */
static void turn_disc(switching_t *plant, int i, int32_t edges)
{
    switching_axis_t *axis = &plant->axis[i];
    axis->slip += edges;
    axis->slip_clock = (axis->slip != 0) ? plant->now + SLIP : NEVER;
}

static void change_axis(switching_t *plant, int i, const board_config_t *config)
{
    const plant_axis_t *c = &config->axis[i];
    switching_axis_t *axis = &plant->axis[i];
    switched_inverter_t *inv = touch(plant, i);
    const terminal_integral_t before = switched_inverter_integral(inv);
    axis->i_noise = plant_faults_noise(&axis->faults.i_noise_configured, axis->i_noise, c->i_noise);
    thermal_change(&axis->winding, c->winding_capacity, c->winding_resistance);
    thermal_change(&axis->sink, c->sink_capacity, c->sink_resistance);
    set_axis(plant, i, config);
    switched_inverter_change(inv, c, c->r_s * thermal_copper(&axis->winding));
    if (c->magnet_coefficient != 0.0) {
        switched_inverter_set_magnet(inv, magnet(plant, i));
    }
    turn_disc(plant, i, quadrature_change(&axis->encoder, c, inv->theta));
    const terminal_integral_t after = switched_inverter_integral(inv);
    for (int k = 0; k < 3; k++) { /* the flux has changed, which no voltage has done */
        axis->window.volts[k] += after.volts[k] - before.volts[k];
    }
}

void switching_change(switching_t *plant, const board_config_t *config)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        /* NOLINTNEXTLINE(bugprone-suspicious-memory-comparison): a difference in padding only costs time */
        if (memcmp(&plant->parameters[i], &config->axis[i], sizeof plant->parameters[i]) != 0) {
            change_axis(plant, i, config);
        }
    }
    find_other_events(plant);
    plant->stale = true;
    switching_find_next_event(plant);
    advance_supply(plant);
    set_bus(plant, &config->bus);
    supply_change(&plant->supply, &config->bus);
}

void switching_set_load(switching_t *plant, int axis, double torque)
{
    (void)touch(plant, axis);
    set_load(plant, axis, torque);
}

void switching_set_friction(switching_t *plant, int i, double friction)
{
    if (friction != plant->axis[i].inverter.friction) {
        touch(plant, i)->friction = friction;
    }
}

void switching_lock(switching_t *plant, int axis, bool locked)
{
    switched_inverter_t *inverter = touch(plant, axis);
    inverter->locked = locked;
    inverter->omega = locked ? 0.0 : inverter->omega;
}

void switching_obstruct(switching_t *plant, int axis, double below, double above)
{
    switched_inverter_t *inverter = touch(plant, axis);
    inverter->stop_min = inverter->theta - below;
    inverter->stop_max = inverter->theta + above;
}

/* The resistance follows with the next step of the temperatures. */
void switching_warm_winding(switching_t *plant, int axis, double celsius) { plant->axis[axis].winding.t = celsius; }

void switching_warm_magnet(switching_t *plant, int axis, double celsius) { plant->t_magnet[axis] = celsius; }

void switching_plug(switching_t *plant, int axis, bool plugged) { switched_inverter_plug(touch(plant, axis), plugged); }

void switching_set_supply(switching_t *plant, double volts)
{
    switching_find_next_event(plant);
    advance_supply(plant);
    supply_set(&plant->supply, volts);
}

void switching_brake(switching_t *plant, bool on)
{
    switching_find_next_event(plant);
    advance_supply(plant);
    supply_switch(&plant->supply, on);
}

void switching_cut(switching_t *plant, int i, int line, bool cut, bool level)
{
    quadrature_t *encoder = &plant->axis[i].encoder;
    pass_deferred(plant, i);
    const bool before = quadrature_level(encoder, line);
    encoder->cut[line] = cut;
    encoder->stuck[line] = level;
    set_line(plant, i, line, before);
}

/* ---- what breaks ---------------------------------------------------------------------------------------------------- */

static void set_sensor_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switching_axis_t *axis = &plant->axis[fault->axis];
    switch ((board_fault_kind_t)fault->kind) {
    case BOARD_STUCK_CONVERTER:
        axis->faults.stuck[fault->part] = !cleared;
        axis->faults.code[fault->part] = plant_code(fault->value);
        break;
    case BOARD_CURRENT_NOISE:
        axis->i_noise = cleared ? axis->faults.i_noise_configured : fault->value;
        break;
    case BOARD_BUS_NOISE:
        plant->u_noise = cleared ? plant->u_noise_configured : fault->value;
        break;
    case BOARD_STALLED_CORE:
        break; /* nothing of the plant */
    case BOARD_HEAT:
        axis->faults.sink_held = !cleared;
        axis->sink.t = cleared ? axis->sink.t : fault->value;
        break;
    default:
        break;
    }
}

static void set_phase_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switched_inverter_t *inverter = touch(plant, fault->axis);
    const int to = (int)fault->value;
    if (fault->kind == BOARD_OPEN_PHASE) {
        switched_inverter_open(inverter, fault->part, !cleared);
    } else if (to < 0) {
        switched_inverter_short(inverter, cleared ? -1 : fault->part, -1);
    } else {
        switched_inverter_short(inverter, -1, cleared ? -1 : 3 - fault->part - to);
    }
    watch_cable(plant, fault->axis);
}

static void set_line_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switching_axis_t *axis = &plant->axis[fault->axis];
    axis->faults.glitches[fault->part] = cleared ? 0.0 : fault->value;
    if (!axis->encoder.flipped[fault->part]) { /* else it ends first */
        axis->glitch_clock[fault->part] = next_glitch(plant, fault->axis, fault->part);
    }
    plant->stale = true;
    find_other_events(plant);
}

static void set_disc_fault(switching_t *plant, const board_fault_t *fault)
{
    turn_disc(plant, fault->axis, (int32_t)fault->value);
    plant->stale = true;
    find_other_events(plant);
}

static void set_supply_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switching_find_next_event(plant);
    advance_supply(plant);
    if (cleared) {
        supply_recover(&plant->supply);
    } else {
        supply_dip(&plant->supply, fault->value, fault->seconds);
    }
}

void switching_set_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switch ((board_fault_kind_t)fault->kind) {
    case BOARD_OPEN_PHASE:
    case BOARD_SHORTED_PHASE:
        set_phase_fault(plant, fault, cleared);
        break;
    case BOARD_ENCODER_GLITCHES:
        set_line_fault(plant, fault, cleared);
        break;
    case BOARD_SLIPPED_ENCODER:
        if (!cleared) {
            set_disc_fault(plant, fault);
        }
        break;
    case BOARD_STUCK_LINE:
        switching_cut(plant, fault->axis, fault->part, !cleared, fault->value != 0.0);
        break;
    case BOARD_LOCKED_ROTOR:
        switching_lock(plant, fault->axis, !cleared);
        break;
    case BOARD_SUPPLY_DIP:
        set_supply_fault(plant, fault, cleared);
        break;
    default:
        set_sensor_fault(plant, fault, cleared);
        break;
    }
}
