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
#define EDGE_HORIZON (BRIDGE_FRAME + SWITCHING_HORIZON * CLOCK)
#define THERMAL_WINDOWS 16u /* from one step of the temperatures to the next */
#define GLITCH 100u /* a disturbance of an encoder line lasts so long [clocks] */
#define SLIP 100u /* from edge to edge of a disc that slips [clocks] */

static void find_rare(switching_t *plant);

static double seconds(uint64_t from, uint64_t to) { return (double)(int64_t)(to - from) * CLOCK; }

/* On the second mass, where there is one; the next step adds what stops, shaft and cogging take. */
static void set_load(switching_t *plant, int i, double torque)
{
    shaft_t *shaft = &plant->shaft[i];
    shaft->load = plant->given[i].load_torque = torque;
    plant->stop[i].load = shaft->two_masses ? 0.0 : torque;
    plant->axis[i].bridge.load = plant->stop[i].load + (shaft->two_masses ? shaft->torque : 0.0);
}

/* What the configuration says of the sensors, the switches and the end stops of an axis. */
static void set_axis(switching_t *plant, int i, const board_config_t *config)
{
    const plant_axis_t *c = &config->axis[i];
    switching_axis_t *axis = &plant->axis[i];
    const double l = (c->l_d < c->l_q) ? c->l_d : c->l_q;
    plant->given[i] = *c;
    shaft_change(&plant->shaft[i], c, axis->bridge.theta, axis->bridge.omega);
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
    plant->u_noise = plant_harm_noise(&plant->u_noise_whole, plant->u_noise, bus->u_noise);
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
    plant->rare_clock = plant->window;
    plant->shaft_clock = NEVER;
    for (int i = 0; i < BOARD_AXES; i++) {
        const plant_axis_t *c = &config->axis[i];
        switching_axis_t *axis = &plant->axis[i];
        bridge_init(&axis->bridge, c);
        set_axis(plant, i, config);
        axis->window = bridge_integral(&axis->bridge);
        quadrature_init(&axis->encoder, c, config->seed, (uint64_t)i + 3u);
        thermal_init(&axis->winding, c->winding_capacity, c->winding_resistance, config->ambient);
        thermal_init(&axis->sink, c->sink_capacity, c->sink_resistance, config->ambient);
        plant_random_init(&axis->noise, config->seed, (uint64_t)i + 1u);
        plant_harm_init(&axis->harm, c, config->seed, (uint64_t)i + 5u);
        for (int line = 0; line < QUADRATURE_LINES; line++) {
            axis->glitch_clock[line] = NEVER;
        }
        axis->slip_clock = NEVER;
        axis->shown_clock = NEVER;
        axis->i_noise = c->i_noise;
        plant->t_magnet[i] = config->ambient;
    }
    find_rare(plant);
}

/* ---- events ------------------------------------------------------------------------------------------------------- */

static inline void tell(switching_t *plant, switching_event_t event)
{
    if (plant->waiting < SWITCHING_EVENTS) {
        plant->event[(plant->first + plant->waiting++) % SWITCHING_EVENTS] = event;
    }
}

bool switching_take(switching_t *plant, switching_event_t *event)
{
    if (plant->waiting == 0u) {
        return false;
    }
    *event = plant->event[plant->first];
    plant->first = (plant->first + 1u) % SWITCHING_EVENTS;
    plant->waiting--;
    return true;
}

/* ---- looking ahead ------------------------------------------------------------------------------------------------ */

static uint64_t earlier(uint64_t a, uint64_t b) { return (a < b) ? a : b; }

/* Clock at or after a time counted from `clock`, and behind another one. */
static inline uint64_t clock_after(uint64_t clock, double time, uint64_t last)
{
    const uint64_t at = clock + (uint64_t)(int64_t)(time * SWITCHING_CLOCK_HZ) + 1u;
    return (at > last) ? at : last + 1u;
}

/* Straight on, when does a current reach the comparator's threshold, from either side? */
static uint64_t look_ahead(const switching_t *plant, const switching_axis_t *axis)
{
    const bridge_t *b = &axis->bridge;
    const double side = 0.5 * PLANT_SQRT3 * b->di.beta;
    const double slope[3] = {b->di.alpha, -0.5 * b->di.alpha + side, -0.5 * b->di.alpha - side};
    double soonest = SWITCHING_HORIZON * CLOCK;
    for (int k = 0; k < 3; k++) {
        const double size = fabs(b->phase[k]);
        const double grows = (b->phase[k] > 0.0) ? slope[k] : -slope[k];
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
    if (target > axis->bridge.high || target < axis->bridge.low) {
        return; /* beyond an end stop */
    }
    /* An edge drawn on the other side of the shaft is behind it, however far it has gone since: that is passed at once. */
    const double way = target - axis->course.theta;
    if ((axis->encoder.upwards ? way : -way) > axis->course.range) {
        return;
    }
    const double t = quadrature_time(&axis->encoder, &axis->course) - axis->course_time;
    if (t < EDGE_HORIZON) {
        axis->edge_clock = clock_after(axis->course_clock, (t > 0.0) ? t : 0.0, last);
    }
}

/* Whether the edges of a course may be kept back: all of them, or none. */
static inline void find_patience(switching_axis_t *axis)
{
    const double edges = (axis->patience > SPREAD) ? (double)(axis->patience - SPREAD) : 0.0;
    axis->keeps = axis->course.range < edges * axis->encoder.pitch;
    axis->told_clock = axis->keeps ? NEVER : axis->edge_clock;
}

static inline void find_next(switching_axis_t *axis)
{
    axis->next_clock = earlier(earlier(axis->told_clock, axis->look_clock), axis->clock + SWITCHING_HORIZON);
}

static inline void find_next_of_all(switching_t *plant)
{
    plant->next = earlier(plant->rare_clock, earlier(plant->axis[0].next_clock, plant->axis[1].next_clock));
}

static void find_rare(switching_t *plant)
{
    plant->rare_clock = plant->window_clock;
    if (!plant->shaft[0].fine && !plant->shaft[1].fine) {
        plant->shaft_clock = NEVER;
    } else if (plant->shaft_clock == NEVER) {
        plant->shaft_clock = plant->now + 1u;
    }
    plant->rare_clock = earlier(plant->rare_clock, plant->shaft_clock);
    for (int i = 0; i < BOARD_AXES; i++) {
        if (plant->axis[i].short_clock > plant->now) {
            plant->rare_clock = earlier(plant->rare_clock, plant->axis[i].short_clock);
        }
        for (int line = 0; line < QUADRATURE_LINES; line++) {
            plant->rare_clock = earlier(plant->rare_clock, plant->axis[i].glitch_clock[line]);
        }
        plant->rare_clock = earlier(plant->rare_clock, plant->axis[i].slip_clock);
    }
}

/* Of the current vector [A^2]. */
static inline double square_of(const switching_axis_t *axis)
{
    const plant_vector_t current = axis->bridge.i;
    return current.alpha * current.alpha + current.beta * current.beta;
}

/* What an axis draws from the bus in the segment that has begun. */
static inline void draw(switching_t *plant, int i)
{
    plant->i_bus[i] = bridge_drain(&plant->axis[i].bridge);
    plant->di_bus[i] = bridge_drain_slope(&plant->axis[i].bridge);
}

/* Edges that are kept back happen up to the present clock, while the shaft's course is still known. */
static inline void pass_kept(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    while (axis->keeps && axis->edge_clock <= plant->now && axis->patience > 0u) {
        const uint64_t clock = axis->edge_clock;
        const quadrature_edge_t edge = quadrature_pass(&axis->encoder);
        if (edge.seen) {
            axis->kept_back[axis->kept++] =
                (switching_event_t){clock, SWITCHING_ENCODER, (uint8_t)i, edge.line, edge.level};
            axis->patience--;
        }
        find_edge(axis, clock);
    }
}

/* What follows from the segment of an axis that has begun at the present clock, with this square of the current. */
static inline void look_at(switching_t *plant, int i, double square)
{
    switching_axis_t *axis = &plant->axis[i];
    bridge_t *b = &axis->bridge;
    draw(plant, i);
    if (b->moved) {
        b->moved = false;
        pass_kept(plant, i);
        axis->course = quadrature_course(&axis->encoder, b->theta, b->omega, b->accel, b->jerk, EDGE_HORIZON);
        axis->course_clock = axis->clock;
        axis->course_time = b->frame.time;
        find_edge(axis, plant->now);
        find_patience(axis);
    }
    axis->look_clock = (square < axis->square_far) ? NEVER : look_ahead(plant, axis);
    find_next(axis);
}

/* After whatever has changed at the present clock. */
void switching_look_around(switching_t *plant)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        if (!plant->axis[i].bridge.begun) {
            bridge_begin(&plant->axis[i].bridge, plant->supply.u);
            look_at(plant, i, square_of(&plant->axis[i]));
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
        plant->booked[i] += h * (plant->i_bus[i] + 0.5 * rise);
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
    const double *p = axis->bridge.phase;
    const double most = axis->i_break;
    const bool tripped = p[0] > most || p[1] > most || p[2] > most || p[0] < -most || p[1] < -most || p[2] < -most ||
                         axis->short_clock > plant->now;
    if (tripped != axis->tripped) {
        axis->tripped = tripped;
        tell(plant, (switching_event_t){plant->now, SWITCHING_OVER_CURRENT, (uint8_t)i, 0, tripped});
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
    const double charge = bridge_advance(&axis->bridge, h, plant->u_h[i] * per_h);
    supply_take(&plant->supply, charge - plant->booked[i]);
    plant->booked[i] = 0.0;
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
    const plant_axis_t *c = &plant->given[i];
    return c->psi_m * (1.0 + c->magnet_coefficient * (plant->t_magnet[i] - plant->axis[i].winding.ambient));
}

static void warm_up(switching_t *plant)
{
    const double h = (double)(THERMAL_WINDOWS * plant->window) * CLOCK;
    for (int i = 0; i < BOARD_AXES; i++) {
        switching_axis_t *axis = &plant->axis[i];
        bridge_t *b = &axis->bridge;
        bridge_settle(b);
        plant->stale = true;
        thermal_advance(&axis->winding, h, b->e_copper - axis->e_copper);
        if (!axis->harm.heated) {
            thermal_advance(&axis->sink, h, b->e_switch - axis->e_switch);
        }
        axis->e_copper = b->e_copper;
        axis->e_switch = b->e_switch;
        bridge_set_winding(b, axis->r_s * thermal_copper(&axis->winding));
        plant->t_magnet[i] += thermal_magnet(h, plant->given[i].magnet_time) * (axis->winding.t - plant->t_magnet[i]);
        if (plant->given[i].magnet_coefficient != 0.0) {
            bridge_set_magnet(b, magnet(plant, i));
            b->moved = true;
        }
    }
    supply_warm(&plant->supply, h);
}

/* What end stops, shaft and cogging do to a rotor until the next time. */
static void push_back(switching_t *plant, int i)
{
    bridge_t *b = &plant->axis[i].bridge;
    bridge_settle(b);
    b->load = end_stop_load(&plant->stop[i], b->theta, b->omega);
    if (plant->shaft[i].fine) {
        b->load += shaft_step(&plant->shaft[i], b->theta, b->omega, SHAFT);
    }
    b->begun = false;
    b->moved = true;
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
        const bridge_integral_t now = bridge_integral(&axis->bridge);
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
        plant->axis[i].window = bridge_integral(&plant->axis[i].bridge);
    }
    plant->window_clock += plant->window;
}

/* A line of an encoder changes, and somebody may wait for it. */
static void tell_line(switching_t *plant, int i, int line, bool level)
{
    tell(plant, (switching_event_t){plant->now, SWITCHING_ENCODER, (uint8_t)i, (uint8_t)line, level});
    plant->axis[i].patience -= (plant->axis[i].patience > 0u) ? 1u : 0u;
}

static inline void pass_edge(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    const quadrature_edge_t edge = quadrature_pass(&axis->encoder);
    if (edge.seen) {
        tell_line(plant, i, edge.line, edge.level);
    }
    find_edge(axis, plant->now);
    axis->told_clock = axis->edge_clock;
    find_next(axis);
}

/* The shaft has had no part in this. */
static void set_line(switching_t *plant, int i, int line, bool before)
{
    switching_axis_t *axis = &plant->axis[i];
    const bool after = quadrature_level(&axis->encoder, line);
    if (after != before) {
        tell_line(plant, i, line, after);
        find_patience(axis);
        find_next(axis);
        plant->stale = true;
    }
}

/* When a line is disturbed next: any time up to twice the mean is as likely as any other. */
static uint64_t next_glitch(switching_t *plant, int i, int line)
{
    plant_harm_t *harm = &plant->axis[i].harm;
    if (harm->glitches[line] <= 0.0) {
        return NEVER;
    }
    return plant->now + GLITCH + (uint64_t)(2.0 * SWITCHING_CLOCK_HZ / harm->glitches[line] * plant_harm_chance(harm));
}

/* A disturbance begins or ends. */
static void glitch(switching_t *plant, int i, int line)
{
    switching_axis_t *axis = &plant->axis[i];
    pass_kept(plant, i);
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
    pass_kept(plant, i);
    const bool upwards = axis->slip > 0;
    const int line = ((axis->encoder.position + upwards) & 1) == 0;
    const bool before = quadrature_level(&axis->encoder, line);
    quadrature_slip(&axis->encoder, upwards);
    set_line(plant, i, line, before);
    axis->slip -= upwards ? 1 : -1;
    axis->slip_clock = (axis->slip != 0) ? plant->now + SLIP : NEVER;
}

static void happen_rarely(switching_t *plant)
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
    find_rare(plant);
}

void switching_happen(switching_t *plant)
{
    plant->now = plant->next;
    for (int i = 0; i < BOARD_AXES; i++) {
        const switching_axis_t *axis = &plant->axis[i];
        if (axis->next_clock == plant->now) {
            if (axis->told_clock == plant->now) {
                pass_edge(plant, i);
            } else {
                advance_axis(plant, i);
            }
        }
    }
    if (plant->rare_clock == plant->now) {
        happen_rarely(plant);
    }
    if (!plant->stale) {
        find_next_of_all(plant);
    }
}

/* ---- edges that nobody waits for --------------------------------------------------------------------------------------- */

void switching_keep_back(switching_t *plant, int i, unsigned edges)
{
    switching_axis_t *axis = &plant->axis[i];
    pass_kept(plant, i);
    const unsigned room = SWITCHING_KEPT - axis->kept;
    const unsigned most = (edges < room) ? edges : room;
    axis->patience = (most > plant->waiting) ? most - plant->waiting : 0u; /* some of those may be edges, too */
    find_patience(axis);
    find_next(axis);
    if (!plant->stale) {
        find_next_of_all(plant);
    }
}

bool switching_take_kept(switching_t *plant, int i, switching_event_t *event)
{
    switching_axis_t *axis = &plant->axis[i];
    pass_kept(plant, i);
    if (axis->kept_first == axis->kept) {
        axis->kept_first = axis->kept = 0;
        return false;
    }
    *event = axis->kept_back[axis->kept_first++];
    return true;
}

/* ---- gates -------------------------------------------------------------------------------------------------------- */

/* For the comparator: how a leg with both switches on carries the motor's current is not modelled. */
static void begin_short(switching_t *plant, int i, uint64_t until)
{
    plant->axis[i].short_clock = until;
    plant->stale = true;
    find_rare(plant);
    compare(plant, i);
}

/* Both rails on a short in the motor's cable: one upper switch against bus minus, or against the other phase's lower one. */
static bool feeds_short(const switching_axis_t *axis)
{
    const bridge_t *b = &axis->bridge;
    if (b->grounded >= 0) {
        return axis->leg[b->grounded] == SWITCHING_HIGH;
    }
    if (b->alone >= 0) {
        const switching_leg_t one = axis->leg[(b->alone + 1) % 3];
        const switching_leg_t other = axis->leg[(b->alone + 2) % 3];
        return (one == SWITCHING_HIGH && other == SWITCHING_LOW) || (one == SWITCHING_LOW && other == SWITCHING_HIGH);
    }
    return false;
}

static void watch_cable(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    const bool feeds = feeds_short(axis);
    if (feeds != axis->feeds) {
        axis->feeds = feeds;
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
    if (axis->bridge.shorted) {
        watch_cable(plant, i);
    }
}

/* The axis goes on with other gates. */
static inline void switch_over(switching_t *plant, int i, unsigned gates)
{
    switching_axis_t *axis = &plant->axis[i];
    bridge_t *b = &axis->bridge;
    double u = plant->supply.u;
    double square;
    if (axis->clock != plant->now) {
        u = move_axis(plant, i, &square);
    } else {
        bridge_begin_again(b); /* several legs switch at one clock */
        square = square_of(axis);
    }
    b->gates = gates;
    bridge_begin(b, u);
    look_at(plant, i, square);
    find_next_of_all(plant);
}

void switching_edge(switching_t *plant, int i, int phase, switching_leg_t leg)
{
    switching_axis_t *axis = &plant->axis[i];
    bridge_t *b = &axis->bridge;
    if (axis->leg[phase] == leg) {
        return;
    }
    const unsigned gates = bridge_gates_with(b, phase, leg);
    if (bridge_indifferent(b, phase, gates, seconds(axis->clock, plant->now), plant->supply.u)) {
        b->gates = gates;
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
    switching_look(plant);
    if (!bridge_amplifiers(&axis->bridge, seconds(axis->clock, plant->now), plant->supply.u, axis->shown)) {
        advance_axis(plant, i);
        switching_look_around(plant);
        memcpy(axis->shown, axis->bridge.amplifier, sizeof axis->shown);
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
        axis->shown[BRIDGE_LANE(phase)] + axis->i_offset[phase] + axis->i_noise * plant_random_gauss(&axis->noise);
    return plant_harm_code(&axis->harm, phase, plant_code(2048.0 + shown * axis->codes_per_ampere));
}

uint16_t switching_bus_code(switching_t *plant)
{
    switching_look(plant);
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
    switching_look_around(&copy);
    advance_supply(&copy);
    advance_axis(&copy, axis);
    bridge_settle(&copy.axis[axis].bridge);
    return copy;
}

double switching_theta(const switching_t *plant, int i)
{
    const switching_axis_t *axis = &plant->axis[i];
    return axis->bridge.theta + axis->bridge.omega * seconds(axis->clock, plant->now);
}

void switching_truth(const switching_t *plant, int i, switching_truth_t *truth)
{
    switching_t copy = here(plant, i);
    switching_look_around(&copy);
    const switching_axis_t *axis = &copy.axis[i];
    const bridge_t *b = &axis->bridge;
    const shaft_t *shaft = &copy.shaft[i];
    const bool two = shaft->two_masses;
    const double rest = two ? seconds(copy.now, copy.shaft_clock) : 0.0;
    *truth = (switching_truth_t){
        .theta = b->theta,
        .omega = b->omega,
        .i_d = b->i.alpha * b->cosine + b->i.beta * b->sine,
        .i_q = b->i.beta * b->cosine - b->i.alpha * b->sine,
        .torque = b->torque,
        .theta_load = two ? shaft->theta - rest * (shaft->omega - 0.5 * rest * shaft->accel) : b->theta,
        .omega_load = two ? shaft->omega - rest * shaft->accel : b->omega,
        .torque_shaft = two ? shaft->torque : 0.0,
        .t_magnet = copy.t_magnet[i],
        .r_s = b->r_s,
        .psi_m = b->psi_m,
        .l_d = 1.0 / (b->inv_l_mean + b->inv_l_half),
        .l_q = 1.0 / (b->inv_l_mean - b->inv_l_half),
        .t_winding = axis->winding.t,
        .t_sink = axis->sink.t,
        .e_bus = b->e_bus,
        .e_copper = b->e_copper,
        .e_switch = b->e_switch,
        .over_current = axis->tripped,
    };
    for (int k = 0; k < 3; k++) {
        truth->voltage[k] = axis->voltage[k];
        truth->phase[k] = b->phase[k];
        truth->shunt[k] = bridge_shunt(b, k);
        truth->amplifier[k] = b->amplifier[BRIDGE_LANE(k)];
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
static bridge_t *touch(switching_t *plant, int i)
{
    switching_look_around(plant);
    bridge_t *bridge = &plant->axis[i].bridge;
    pass_kept(plant, i);
    advance_axis(plant, i);
    bridge_settle(bridge);
    bridge->begun = false;
    bridge->moved = true;
    plant->stale = true;
    return bridge;
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
    bridge_t *b = touch(plant, i);
    const bridge_integral_t before = bridge_integral(b);
    axis->i_noise = plant_harm_noise(&axis->harm.i_whole, axis->i_noise, c->i_noise);
    thermal_change(&axis->winding, c->winding_capacity, c->winding_resistance);
    thermal_change(&axis->sink, c->sink_capacity, c->sink_resistance);
    set_axis(plant, i, config);
    bridge_change(b, c, c->r_s * thermal_copper(&axis->winding));
    if (c->magnet_coefficient != 0.0) {
        bridge_set_magnet(b, magnet(plant, i));
    }
    turn_disc(plant, i, quadrature_change(&axis->encoder, c, b->theta));
    const bridge_integral_t after = bridge_integral(b);
    for (int k = 0; k < 3; k++) { /* the flux has changed, which no voltage has done */
        axis->window.volts[k] += after.volts[k] - before.volts[k];
    }
}

void switching_change(switching_t *plant, const board_config_t *config)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        /* NOLINTNEXTLINE(bugprone-suspicious-memory-comparison): a difference in padding only costs time */
        if (memcmp(&plant->given[i], &config->axis[i], sizeof plant->given[i]) != 0) {
            change_axis(plant, i, config);
        }
    }
    find_rare(plant);
    plant->stale = true;
    switching_look_around(plant);
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
    if (friction != plant->axis[i].bridge.friction) {
        touch(plant, i)->friction = friction;
    }
}

void switching_lock(switching_t *plant, int axis, bool locked)
{
    bridge_t *bridge = touch(plant, axis);
    bridge->locked = locked;
    bridge->omega = locked ? 0.0 : bridge->omega;
}

void switching_obstruct(switching_t *plant, int axis, double below, double above)
{
    bridge_t *bridge = touch(plant, axis);
    bridge->low = bridge->theta - below;
    bridge->high = bridge->theta + above;
}

/* The resistance follows with the next step of the temperatures. */
void switching_warm_winding(switching_t *plant, int axis, double celsius) { plant->axis[axis].winding.t = celsius; }

void switching_warm_magnet(switching_t *plant, int axis, double celsius) { plant->t_magnet[axis] = celsius; }

void switching_plug(switching_t *plant, int axis, bool plugged) { bridge_plug(touch(plant, axis), plugged); }

void switching_set_supply(switching_t *plant, double volts)
{
    switching_look_around(plant);
    advance_supply(plant);
    supply_set(&plant->supply, volts);
}

void switching_brake(switching_t *plant, bool on)
{
    switching_look_around(plant);
    advance_supply(plant);
    supply_switch(&plant->supply, on);
}

void switching_cut(switching_t *plant, int i, int line, bool cut, bool level)
{
    quadrature_t *encoder = &plant->axis[i].encoder;
    pass_kept(plant, i);
    const bool before = quadrature_level(encoder, line);
    encoder->cut[line] = cut;
    encoder->stuck[line] = level;
    set_line(plant, i, line, before);
}

/* ---- what breaks ---------------------------------------------------------------------------------------------------- */

static void harm_sensor(switching_t *plant, const board_harm_t *harm, bool healed)
{
    switching_axis_t *axis = &plant->axis[harm->axis];
    switch ((board_harm_kind_t)harm->kind) {
    case BOARD_STUCK_CONVERTER:
        axis->harm.stuck[harm->part] = !healed;
        axis->harm.code[harm->part] = plant_code(harm->value);
        break;
    case BOARD_CURRENT_NOISE:
        axis->i_noise = healed ? axis->harm.i_whole : harm->value;
        break;
    case BOARD_BUS_NOISE:
        plant->u_noise = healed ? plant->u_noise_whole : harm->value;
        break;
    case BOARD_STALLED_CORE:
        break; /* nothing of the plant */
    case BOARD_HEAT:
        axis->harm.heated = !healed;
        axis->sink.t = healed ? axis->sink.t : harm->value;
        break;
    default:
        break;
    }
}

static void harm_phase(switching_t *plant, const board_harm_t *harm, bool healed)
{
    bridge_t *bridge = touch(plant, harm->axis);
    const int to = (int)harm->value;
    if (harm->kind == BOARD_OPEN_PHASE) {
        bridge_open(bridge, harm->part, !healed);
    } else if (to < 0) {
        bridge_short(bridge, healed ? -1 : harm->part, -1);
    } else {
        bridge_short(bridge, -1, healed ? -1 : 3 - harm->part - to);
    }
    watch_cable(plant, harm->axis);
}

static void harm_line(switching_t *plant, const board_harm_t *harm, bool healed)
{
    switching_axis_t *axis = &plant->axis[harm->axis];
    axis->harm.glitches[harm->part] = healed ? 0.0 : harm->value;
    if (!axis->encoder.flipped[harm->part]) { /* else it ends first */
        axis->glitch_clock[harm->part] = next_glitch(plant, harm->axis, harm->part);
    }
    plant->stale = true;
    find_rare(plant);
}

static void harm_disc(switching_t *plant, const board_harm_t *harm)
{
    turn_disc(plant, harm->axis, (int32_t)harm->value);
    plant->stale = true;
    find_rare(plant);
}

static void harm_supply(switching_t *plant, const board_harm_t *harm, bool healed)
{
    switching_look_around(plant);
    advance_supply(plant);
    if (healed) {
        supply_recover(&plant->supply);
    } else {
        supply_dip(&plant->supply, harm->value, harm->seconds);
    }
}

void switching_harm(switching_t *plant, const board_harm_t *harm, bool healed)
{
    switch ((board_harm_kind_t)harm->kind) {
    case BOARD_OPEN_PHASE:
    case BOARD_SHORTED_PHASE:
        harm_phase(plant, harm, healed);
        break;
    case BOARD_ENCODER_GLITCHES:
        harm_line(plant, harm, healed);
        break;
    case BOARD_SLIPPED_ENCODER:
        if (!healed) {
            harm_disc(plant, harm);
        }
        break;
    case BOARD_STUCK_LINE:
        switching_cut(plant, harm->axis, harm->part, !healed, harm->value != 0.0);
        break;
    case BOARD_LOCKED_ROTOR:
        switching_lock(plant, harm->axis, !healed);
        break;
    case BOARD_SUPPLY_DIP:
        harm_supply(plant, harm, healed);
        break;
    default:
        harm_sensor(plant, harm, healed);
        break;
    }
}
