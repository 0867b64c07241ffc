/* switching.h - both inverters, motors and the DC bus at switching level: every gate edge at its own instant, dead times in
 * which the sign of the current selects a diode, shunts that carry a current only while the lower half of their leg
 * conducts, encoder lines with the edge times of the moving shaft.
 *
 * Time is counted in clocks of the chip (board_clock.h). The plant is one more source of events: between two calls of
 * switching_edge nothing outside acts on it, so it can predict its own next event.
 *
 *     while (...) {
 *         const uint64_t clock = min(next event of the chip, switching_next(plant));
 *         switching_advance(plant, clock);
 *         while (switching_take(plant, &event)) ...        encoder lines, comparator; event.clock == clock
 *         ... the chip's own event: sample, or switching_edge(plant, axis, phase, leg) ...
 *     }
 *
 * Advancing past switching_next is allowed: the events are queued in order with their own clocks, at most SWITCHING_EVENTS.
 * Edges of an encoder that the chip does not need at once can be deferred (switching_defer_edges): they cost no stop at their
 * clocks and are taken later. Readings (shunts, bus, truth) are those of the clock last advanced to.
 */
#ifndef PLANT_SWITCHING_H
#define PLANT_SWITCHING_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "plant/converter.h"
#include "plant/driven_shaft.h"
#include "plant/end_stop.h"
#include "plant/injected_faults.h"
#include "plant/noise.h"
#include "plant/quadrature.h"
#include "plant/shaft.h"
#include "plant/supply.h"
#include "plant/switched_inverter.h"
#include "plant/thermal.h"

#define SWITCHING_CLOCK_HZ INVERTER_CLOCK_HZ
#define SWITCHING_HORIZON (32u * BOARD_CLOCK_MHZ) /* longest step of the plant, 32 us [clocks] */
#define SWITCHING_SHAFT                                                                                                \
    (25u * BOARD_CLOCK_MHZ >> 2) /* step of shafts that need shorter ones than a PWM period, 6.25 us [clocks] */
#define SWITCHING_LINE 64u /* alignment of a plant, for speed: a cache line [bytes] */
#define SWITCHING_EVENTS 128u /* size of the queue, a power of two */
#define SWITCHING_DEFERRED_MAX 135u /* deferred encoder edges of an axis, which fill whole cache lines */

/* Gate signals of one leg: bit 0 the upper switch, bit 1 the lower one. */
typedef enum {
    SWITCHING_OPEN = GATES_OPEN,
    SWITCHING_HIGH = GATES_HIGH,
    SWITCHING_LOW = GATES_LOW,
    SWITCHING_SHORT = 3, /* both on: the comparator trips as long as it lasts; for the motor the leg is open */
} switching_leg_t;

typedef enum {
    SWITCHING_ENCODER, /* an encoder line has changed: `line` 0: A, 1: B; `level` is the new one */
    SWITCHING_OVER_CURRENT, /* output of an axis' over-current comparator: `level` 1 tripped, 0 released */
} switching_kind_t;

typedef struct {
    uint64_t clock; /* bus clocks since reset */
    uint8_t kind; /* switching_kind_t */
    uint8_t axis;
    uint8_t line;
    bool level;
} switching_event_t;

/* One axis. It is advanced only when its own gates change or something reads it. Clocks are absolute. */
typedef struct {
    switched_inverter_t inverter;
    driven_shaft_t driven; /* at the end of the present window */
    quadrature_t encoder;
    thermal_t winding, sink;
    plant_random_t noise;
    plant_faults_t faults;
    uint64_t clock; /* clock up to which the axis has been advanced */
    uint64_t edge_clock; /* next encoder edge */
    uint64_t report_clock; /* edge_clock if the edge is an event, never if it is deferred */
    quadrature_trajectory_t trajectory; /* extrapolated motion of the shaft */
    uint64_t trajectory_clock; /* clock at which `trajectory_time` was computed */
    double trajectory_time; /* time since the beginning of the trajectory at trajectory_clock [s] */
    unsigned deferrable_edges; /* number of encoder edges that may still be deferred */
    bool defers; /* all edges of the present trajectory are deferred */
    uint8_t deferred_first, deferred_count; /* indices of `deferred`: first edge not processed, number of edges */
    uint64_t shown_clock; /* clock of `shown` */
    double shown[INVERTER_LANES]; /* outputs of the current amplifiers [A] */
    uint64_t trip_clock; /* earliest clock at which a current may reach the comparator's threshold */
    uint64_t next_clock; /* earliest of report_clock, trip_clock and the horizon */
    uint64_t safe_clock[3]; /* end of the shortest dead time: before, the other switch of the leg must not close */
    switching_leg_t last_on[3]; /* switch of the leg that was on last */
    switching_leg_t leg[3];
    uint64_t short_clock; /* end of a short through a leg */
    bool tripped; /* output of the comparator */
    bool short_fed; /* both rails feed a short in the motor's cable */
    int32_t slip; /* edges still to come of a slipping disc */
    uint64_t glitch_clock[QUADRATURE_LINES]; /* beginning or end of the next disturbance on a line */
    uint64_t slip_clock; /* next edge of a slipping disc */
    uint64_t dead_time_min; /* [clocks] */
    double i_break; /* threshold of the comparator [A] */
    double square_break; /* its square; a current vector below has no phase beyond the threshold [A^2] */
    double square_far; /* a current vector below cannot reach the threshold within the horizon [A^2] */
    double codes_per_ampere; /* [1/A] */
    double i_offset[3], i_noise; /* current sample: offset [A], standard deviation [A] */
    double r_s; /* winding at the reference temperature [ohm] */
    double e_copper, e_switch; /* losses that the temperatures already include [J] */
    terminal_integral_t window; /* terminal voltages at the beginning of the present window */
    double voltage[3]; /* mean terminal voltages of the last window [V] */
    switching_event_t deferred[SWITCHING_DEFERRED_MAX];
    double unused[7]; /* the other axis begins at a cache line */
} switching_axis_t;

typedef struct {
    switching_axis_t axis[BOARD_AXES];
    end_stop_t stop[BOARD_AXES];
    shaft_t shaft[BOARD_AXES]; /* at the end of the present step of SWITCHING_SHAFT */
    uint64_t shaft_clock; /* end of that step */
    double t_magnet[BOARD_AXES]; /* [deg C] */
    supply_t supply;
    double u_noise, u_noise_configured; /* standard deviation of a bus sample; without a fault [V] */
    double codes_per_volt; /* [1/V] */
    plant_random_t noise;
    uint64_t now; /* present clock */
    uint64_t next; /* clock of the next event, unless `stale` */
    bool stale; /* `next` has to be found again */
    uint64_t supply_clock; /* clock up to which the bus has been advanced */
    double i_bus[BOARD_AXES], di_bus[BOARD_AXES]; /* current that an axis draws at supply_clock, its slope [A], [A/s] */
    double charge_booked[BOARD_AXES]; /* charge drawn at this current since the axis was advanced [A s] */
    double u_h[BOARD_AXES]; /* integral of the bus voltage since then [V s] */
    uint64_t window, window_clock; /* length and end of the present window [clocks] */
    bool too_fast; /* shaft_too_fast at the end of a window: do not advance the plant any more */
    unsigned windows; /* windows since the last step of the temperatures */
    uint64_t other_clock; /* next event but encoder edges and trips: window, shaft, short, disturbance */
    switching_event_t event[SWITCHING_EVENTS];
    unsigned first, pending; /* indices of `event`: oldest event, number of events */
    plant_axis_t parameters[BOARD_AXES]; /* as last configured */
} switching_t;

/* All switches open, shafts at rest, bus charged, clock 0. */
void switching_init(switching_t *plant, const board_config_t *config);

/* ---- time --------------------------------------------------------------------------------------------------------- */

/* Parts of switching_next and switching_advance: find the next event; advance to it and process it. */
void switching_find_next_event(switching_t *plant);
void switching_process_event(switching_t *plant);

/* Gates of a leg from the present clock on. Several legs may change at one clock. */
void switching_edge(switching_t *plant, int axis, int phase, switching_leg_t leg);

/* Clock of the plant's next event if no gate changes before, later than the present one. At most SWITCHING_HORIZON away, where
 * possibly nothing happens. */
static inline uint64_t switching_next(switching_t *plant)
{
    if (plant->stale) {
        switching_find_next_event(plant);
    }
    return plant->next;
}

/* Advance to `clock`, the present one or later. */
static inline void switching_advance(switching_t *plant, uint64_t clock)
{
    while (switching_next(plant) <= clock) {
        switching_process_event(plant);
    }
    plant->now = clock;
}

/* Take the oldest event; false if there is none. */
bool switching_take(switching_t *plant, switching_event_t *event);

/* Allow the next `edges` of an axis' encoder to be deferred. Take those deferred so far before. */
void switching_defer_edges(switching_t *plant, int axis, unsigned edges);

/* Take the oldest deferred edge of an axis up to the present clock; false if there is none. It precedes those of
 * switching_take. */
bool switching_take_deferred(switching_t *plant, int axis, switching_event_t *event);

/* ---- pins of the chip at the present clock -------------------------------------------------------------------------- */

/* Converter code (12 bits, mid-scale 2048) of a phase's current amplifier: shunt current behind the amplifier's lag, with
 * offset and noise. Each call draws new noise. */
uint16_t switching_current_code(switching_t *plant, int axis, int phase);

/* Converter code of the bus divider (12 bits). */
uint16_t switching_bus_code(switching_t *plant);

bool switching_over_current(const switching_t *plant, int axis); /* output of the comparator */
bool switching_line(const switching_t *plant, int axis, int line); /* encoder line 0: A, 1: B, without deferred edges */

/* ---- truth ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    double theta, omega; /* shaft, mechanical, not wrapped [rad], [rad/s] */
    double i_d, i_q; /* [A] */
    double phase[3]; /* phase currents into the motor [A] */
    double shunt[3]; /* currents of the shunts, sign of the phase current [A] */
    double amplifier[3]; /* outputs of their amplifiers [A] */
    double torque; /* air gap [N m] */
    double voltage[3]; /* mean terminal voltages above the negative rail in the last full window, a PWM period [V] */
    double t_winding, t_sink, t_magnet; /* [deg C] */
    double theta_load, omega_load, torque_shaft; /* second mass, or the rotor [rad], [rad/s]; between them [N m] */
    double r_s, psi_m, l_d, l_q; /* at the present temperatures; inductances differential [ohm], [V s], [H] */
    double impulse; /* integral of the torque since clock 0 [N m s] */
    double e_bus; /* drawn from the bus since clock 0 [J] */
    double e_copper, e_switch; /* losses in the windings, in switches and diodes [J] */
    bool over_current;
} switching_truth_t;

/* Angle of the shaft, extrapolated from the clock up to which the axis has been advanced [rad]. */
double switching_theta(const switching_t *plant, int axis);

/* Present state of one axis. Reading changes nothing. */
void switching_truth(const switching_t *plant, int axis, switching_truth_t *truth);

typedef struct {
    double u_dc; /* [V] */
    double e_source; /* delivered by the supply into the bus since clock 0 [J] */
    double e_brake; /* dissipated in the brake resistor [J] */
    double t_brake; /* its temperature [deg C] */
} switching_bus_t;

void switching_bus(const switching_t *plant, switching_bus_t *bus);

/* ---- changes from outside, at the present clock --------------------------------------------------------------------- */

/* New parameters, as board_change_plant, without the friction (switching_set_friction). */
void switching_change(switching_t *plant, const board_config_t *config);
void switching_set_load(switching_t *plant, int axis, double torque); /* [N m] */
void switching_set_supply(switching_t *plant, double volts); /* open-circuit voltage [V] */
void switching_lock(switching_t *plant, int axis, bool locked); /* shaft */
void switching_obstruct(switching_t *plant, int axis, double below, double above); /* end stops, from here [rad] */
void switching_drive_shaft(switching_t *plant, int axis, double theta, double omega, double duration);
void switching_release_shaft(switching_t *plant, int axis); /* as board_drive_shaft, board_release_shaft */
void switching_warm_winding(switching_t *plant, int axis, double celsius); /* temperature from now on [deg C] */
void switching_warm_magnet(switching_t *plant, int axis, double celsius); /* temperature from now on [deg C] */
void switching_plug(switching_t *plant, int axis, bool plugged); /* motor cable */
void switching_cut(switching_t *plant, int axis, int line, bool cut, bool level); /* encoder line stuck at a level */
void switching_set_friction(switching_t *plant, int axis, double friction); /* Coulomb friction [N m] */
void switching_brake_resistor(switching_t *plant, bool on); /* brake resistor across the bus */

/* Inject a fault, or clear it. */
void switching_set_fault(switching_t *plant, const board_fault_t *fault, bool cleared);

#endif
