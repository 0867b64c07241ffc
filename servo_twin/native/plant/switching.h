/* switching.h - both inverters, motors and the DC bus at the level of single gate signals: every edge of the PWM at its
 * own instant, both-open intervals in which the current chooses a diode, shunts that see a current only while it goes
 * through the lower half of a leg, encoder lines with the edge times that the moving shaft gives.
 *
 * Time is counted in bus clocks of the chip (10 ns). The plant is one more source of events: between two calls of
 * switching_edge nothing outside acts on it, so it can tell when it will have something to say next.
 *
 *     while (...) {
 *         const uint64_t clock = min(next event of the chip, switching_next(plant));
 *         switching_advance(plant, clock);
 *         while (switching_take(plant, &event)) ...        encoder lines, comparator; event.clock == clock
 *         ... the chip's own event: sample, or switching_edge(plant, axis, phase, leg) ...
 *     }
 *
 * Advancing past switching_next is allowed: the events wait, in order, with their own clocks (at most SWITCHING_EVENTS).
 * Edges of an encoder that nobody waits for may be kept back from all this, until somebody asks for them.
 * What is read (shunts, bus, truth) is the state of the clock last advanced to.
 */
#ifndef PLANT_SWITCHING_H
#define PLANT_SWITCHING_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "plant/bridge.h"
#include "plant/end_stop.h"
#include "plant/harm.h"
#include "plant/quadrature.h"
#include "plant/sensors.h"
#include "plant/shaft.h"
#include "plant/supply.h"
#include "plant/thermal.h"

#define SWITCHING_CLOCK_HZ BRIDGE_CLOCK_HZ
#define SWITCHING_HORIZON 3200u /* longest step without a look around [clocks] */
#define SWITCHING_SHAFT 625u /* step of shafts that need shorter ones than a period, 6.25 us [clocks] */
#define SWITCHING_LINE 64u /* a plant is quicker at a multiple of it [bytes] */
#define SWITCHING_EVENTS 128u /* a power of two */
/* Edges of an encoder that are kept back at most: with so many an axis fills lines of the cache. */
#define SWITCHING_KEPT 132u

/* Gate signals of one leg: bit 0 the upper switch, bit 1 the lower one. */
typedef enum {
    SWITCHING_OPEN = BRIDGE_OPEN,
    SWITCHING_HIGH = BRIDGE_HIGH,
    SWITCHING_LOW = BRIDGE_LOW,
    SWITCHING_SHORT = 3, /* both on: the comparator trips as long as it lasts, the motor sees the leg open */
} switching_leg_t;

typedef enum {
    SWITCHING_ENCODER, /* a line has changed: `line` 0: A, 1: B; `level` is the new one */
    SWITCHING_OVER_CURRENT, /* output of an axis' over-current comparator: `level` 1 tripped, 0 released */
} switching_kind_t;

typedef struct {
    uint64_t clock;
    uint8_t kind; /* switching_kind_t */
    uint8_t axis;
    uint8_t line;
    bool level;
} switching_event_t;

/* One axis. The bridge is advanced only when its own gates change or something asks for it; `clock` is where it stands. */
typedef struct {
    bridge_t bridge;
    quadrature_t encoder;
    thermal_t winding, sink;
    plant_random_t noise;
    plant_harm_t harm;
    uint64_t clock;
    uint64_t edge_clock; /* when the encoder changes next, if nothing else does .. */
    uint64_t told_clock; /* .. and if it is an event */
    quadrature_course_t course; /* of the shaft .. */
    uint64_t course_clock; /* .. at this clock .. */
    double course_time; /* .. as far into it [s] */
    unsigned patience; /* so many edges may be kept back .. */
    bool keeps; /* .. and all of this course will be */
    uint8_t kept_first, kept;
    uint64_t shown_clock; /* the amplifiers have been looked at, .. */
    double shown[BRIDGE_LANES]; /* .. and show this [A] */
    uint64_t look_clock; /* when a current may pass the comparator's threshold */
    uint64_t next_clock; /* the earlier of the two, or the horizon */
    uint64_t safe_clock[3]; /* until then the other switch of the leg is on too soon, and which one was on last */
    switching_leg_t last_on[3];
    switching_leg_t leg[3];
    uint64_t short_clock; /* end of a short through a leg */
    bool tripped; /* output of the comparator */
    bool feeds; /* a short in the motor's cable is between both rails */
    int32_t slip; /* edges still to come of a disc that slips */
    uint64_t glitch_clock[QUADRATURE_LINES]; /* beginning or end of the next disturbance on a line */
    uint64_t slip_clock; /* the next of them */
    uint64_t dead_time_min; /* [clocks] */
    double i_break; /* threshold [A] */
    /* Of a current vector below which no phase is beyond the threshold, or can get there within the horizon [A^2]. */
    double square_break, square_far;
    double codes_per_ampere, i_offset[3], i_noise;
    double r_s; /* at the reference temperature [ohm] */
    double e_copper, e_switch; /* that the temperatures have seen already [J] */
    bridge_integral_t window; /* of the terminals, where the present window began */
    double voltage[3]; /* means of the terminals in the window before [V] */
    switching_event_t kept_back[SWITCHING_KEPT];
} switching_axis_t;

typedef struct {
    switching_axis_t axis[BOARD_AXES];
    end_stop_t stop[BOARD_AXES];
    shaft_t shaft[BOARD_AXES]; /* to the end of the present step of SWITCHING_SHAFT */
    uint64_t shaft_clock; /* the end of that step */
    double t_magnet[BOARD_AXES]; /* [deg C] */
    supply_t supply;
    double u_noise, u_noise_whole, codes_per_volt;
    plant_random_t noise;
    uint64_t now;
    uint64_t next; /* clock of the next event, unless `stale` */
    bool stale;
    uint64_t supply_clock; /* the bus stands here */
    /* Of each axis: current out of the bus there, and its slope; and since the axis was advanced the charge that the bus has
     * given, at this current, and the integral of its voltage [A], [A/s], [A s], [V s]. */
    double i_bus[BOARD_AXES], di_bus[BOARD_AXES], booked[BOARD_AXES], u_h[BOARD_AXES];
    uint64_t window, window_clock; /* length and end of the present window [clocks] */
    unsigned windows; /* that are over since the last step of the temperatures */
    uint64_t rare_clock; /* the end of the window, or of a short */
    switching_event_t event[SWITCHING_EVENTS];
    unsigned first, waiting;
    plant_axis_t given[BOARD_AXES]; /* parameters, as they have been taken over */
} switching_t;

/* All switches open, shafts at rest, bus charged, clock 0. */
void switching_init(switching_t *plant, const board_config_t *config);

/* ---- time --------------------------------------------------------------------------------------------------------- */

/* Parts of the two functions below: find the next event; go there and let it happen. */
void switching_look_around(switching_t *plant);
void switching_happen(switching_t *plant);

/* The first of them, if anything has changed. */
static inline void switching_look(switching_t *plant)
{
    if (plant->stale) {
        switching_look_around(plant);
    }
}

/* From the present clock on a leg's gates are so. Several legs may change at one clock. */
void switching_edge(switching_t *plant, int axis, int phase, switching_leg_t leg);

/* Clock of the plant's own next event if no gate changes before; never further away than SWITCHING_HORIZON, where it may
 * turn out that nothing has happened. Always later than the present clock. */
static inline uint64_t switching_next(switching_t *plant)
{
    switching_look(plant);
    return plant->next;
}

/* To `clock`, the present one or later. */
static inline void switching_advance(switching_t *plant, uint64_t clock)
{
    while (switching_next(plant) <= clock) {
        switching_happen(plant);
    }
    plant->now = clock;
}

/* Oldest event that has not been taken; false if there is none. */
bool switching_take(switching_t *plant, switching_event_t *event);

/* The next `edges` of an axis' encoder may be kept back. Those that have been are to be taken before. */
void switching_keep_back(switching_t *plant, int axis, unsigned edges);

/* Oldest edge of an axis up to the present clock that has been kept back; false if there is none. It belongs before those
 * of switching_take. */
bool switching_take_kept(switching_t *plant, int axis, switching_event_t *event);

/* ---- what the chip's pins see at the present clock ------------------------------------------------------------------ */

/* Converter code (12 bits, mid-scale 2048) of a phase's current amplifier: what its shunt carries, after the amplifier's
 * settling, with offset and noise. Each call draws new noise. */
uint16_t switching_current_code(switching_t *plant, int axis, int phase);

/* Converter code of the bus divider (12 bits). */
uint16_t switching_bus_code(switching_t *plant);

bool switching_over_current(const switching_t *plant, int axis); /* output of the comparator */
/* Level of encoder line 0: A, 1: B; what is still kept back is not in it. */
bool switching_line(const switching_t *plant, int axis, int line);

/* ---- truth ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    double theta, omega; /* shaft, mechanical, not wrapped [rad], [rad/s] */
    double i_d, i_q; /* [A] */
    double phase[3]; /* [A] into the motor */
    double shunt[3]; /* what the shunts carry [A], sign of the phase current */
    double amplifier[3]; /* what the amplifiers show of it [A] */
    double torque; /* air gap [N m] */
    double voltage[3]; /* mean terminal voltages above the negative rail in the last full window, a PWM period [V] */
    double t_winding, t_sink, t_magnet; /* [deg C] */
    double theta_load, omega_load, torque_shaft; /* second mass, or the rotor [rad], [rad/s]; between them [N m] */
    double r_s, psi_m, l_d, l_q; /* winding and magnet as they are; for small changes [ohm], [V s], [H] */
    double e_bus; /* taken out of the bus since clock 0 [J] */
    double e_copper, e_switch; /* burnt in the windings, in switches and diodes [J] */
    bool over_current;
} switching_truth_t;

/* Angle of the shaft, straight on from where the axis was advanced last [rad]. */
double switching_theta(const switching_t *plant, int axis);

/* Present state of one axis. To look changes nothing. */
void switching_truth(const switching_t *plant, int axis, switching_truth_t *truth);

typedef struct {
    double u_dc; /* [V] */
    double e_source; /* delivered by the supply into the bus since clock 0 [J] */
    double e_brake; /* burnt in the brake resistor [J] */
    double t_brake; /* its temperature [deg C] */
} switching_bus_t;

void switching_bus(const switching_t *plant, switching_bus_t *bus);

/* ---- faults and other hands on the plant ---------------------------------------------------------------------------- */

/* Other values of the plant, as board_change_plant; switching_set_friction has the friction. */
void switching_change(switching_t *plant, const board_config_t *config);
void switching_set_load(switching_t *plant, int axis, double torque);
void switching_set_supply(switching_t *plant, double volts);
void switching_lock(switching_t *plant, int axis, bool locked);
/* End stops so far from here [rad]. */
void switching_obstruct(switching_t *plant, int axis, double below, double above);
void switching_warm_winding(switching_t *plant, int axis, double celsius); /* its temperature from now on [deg C] */
void switching_warm_magnet(switching_t *plant, int axis, double celsius); /* the same of the magnet */
void switching_plug(switching_t *plant, int axis, bool plugged); /* motor cable */
void switching_cut(switching_t *plant, int axis, int line, bool cut, bool level); /* encoder line stuck at a level */
void switching_set_friction(switching_t *plant, int axis, double friction); /* Coulomb's [N m] */
void switching_brake(switching_t *plant, bool on); /* brake resistor across the bus */

/* Something breaks, or is whole again. */
void switching_harm(switching_t *plant, const board_harm_t *harm, bool healed);

#endif
