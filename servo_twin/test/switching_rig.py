"""The plant at switching level as Python sees it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from native_library import Native, c_config
from servo_twin.plant import PlantConfig
from switching_reference import Edge

SWITCHING_CDEF = """
typedef struct {
    double i[4], di[4], ddi[4], v[4], inverse[2][4], state_matrix[2][4], emf_term[4], emf_term_slope[4];
    double di_per_volt[3][4], ddi_per_volt[3][4], minus_l_leg[4]; ...;
} linear_interval_t;
typedef struct {
    linear_interval_t interval; double amplifier[4], drops[14][4]; plant_vector_t psi, switch_vector, i, di;
    double theta, omega, phase[3], stop_min, stop_max; unsigned positive, negative, joined; ...;
} switched_inverter_t;
typedef struct { switched_inverter_t inverter; ...; } switching_axis_t;
typedef struct { double speed; ...; } shaft_t;
typedef struct { switching_axis_t axis[2]; shaft_t shaft[2]; supply_t supply; ...; } switching_t;
typedef struct { uint64_t clock; uint8_t kind, axis, line; bool level; } switching_event_t;
double root_of(double f0, double d0, double f1, double h);
unsigned straight_roots(const double f0[4], const double f1[4], const double d0[4], double h, double root[4]);
void switching_init(switching_t *plant, const board_config_t *config);
void switching_edge(switching_t *plant, int axis, int phase, int leg);
uint64_t switching_next(switching_t *plant);
void switching_advance(switching_t *plant, uint64_t clock);
bool switching_take(switching_t *plant, switching_event_t *event);
void switching_defer_edges(switching_t *plant, int axis, unsigned edges);
bool switching_take_deferred(switching_t *plant, int axis, switching_event_t *event);
uint16_t switching_current_code(switching_t *plant, int axis, int phase);
uint16_t switching_bus_code(switching_t *plant);
bool switching_over_current(const switching_t *plant, int axis);
bool switching_line(const switching_t *plant, int axis, int line);
typedef struct {
    double theta, omega, i_d, i_q, phase[3], shunt[3], amplifier[3], torque, voltage[3], t_winding, t_sink, t_magnet;
    double theta_load, omega_load, torque_shaft, r_s, psi_m, l_d, l_q;
    double e_bus, e_copper, e_switch; bool over_current;
} switching_truth_t;
void switching_truth(const switching_t *plant, int axis, switching_truth_t *truth);
typedef struct { double u_dc, e_source, e_brake, t_brake; } switching_bus_t;
void switching_bus(const switching_t *plant, switching_bus_t *bus);
void switching_set_load(switching_t *plant, int axis, double torque);
void switching_set_supply(switching_t *plant, double volts);
void switching_lock(switching_t *plant, int axis, bool locked);
void switching_obstruct(switching_t *plant, int axis, double below, double above);
void switching_plug(switching_t *plant, int axis, bool plugged);
void switching_cut(switching_t *plant, int axis, int line, bool cut, bool level);
typedef struct { int kind, axis, part; double value, seconds; } board_fault_t;
typedef enum { BOARD_ENCODER_GLITCHES, BOARD_SLIPPED_ENCODER, ... } board_fault_kind_t;
void switching_set_fault(switching_t *plant, const board_fault_t *fault, bool cleared);
void switching_brake(switching_t *plant, bool on);
"""


class Switching:
    """A plant that follows lists of edges and keeps the events."""

    def __init__(self, native: Native, plant: PlantConfig, seed: int = 0) -> None:
        self.ffi, self.lib = native.ffi, native.lib
        self.plant = plant
        self.c = self.ffi.new("switching_t *")
        self.lib.switching_init(self.c, c_config(native, plant, seed))
        self.events: list[tuple[int, int, int, int, bool]] = []
        self.clock = 0

    def spin(self, axis: int, omega: float) -> None:
        """Give the shaft a speed; before anything has happened."""
        self.c.axis[axis].inverter.omega = self.c.shaft[axis].speed = omega

    def charge(self, volts: float) -> None:
        """Give the bus a voltage; before anything has happened."""
        self.c.supply.u = volts

    def advance(self, clock: int) -> None:
        event = self.ffi.new("switching_event_t *")
        while self.clock < clock:
            self.clock = min(clock, self.clock + 6250)
            self.lib.switching_advance(self.c, self.clock)
            while self.lib.switching_take(self.c, event):
                self.events.append((event.clock, event.kind, event.axis, event.line, event.level))
        while self.lib.switching_take(self.c, event):
            self.events.append((event.clock, event.kind, event.axis, event.line, event.level))

    def take_deferred(self, axis: int, allowed: int) -> int:
        """Take the deferred edges and allow as many more to be deferred; returns how many there were."""
        event = self.ffi.new("switching_event_t *")
        before = len(self.events)
        while self.lib.switching_take_deferred(self.c, axis, event):
            self.events.append((event.clock, event.kind, event.axis, event.line, event.level))
        self.lib.switching_defer_edges(self.c, axis, allowed)
        return len(self.events) - before

    def edge(self, axis: int, phase: int, gates: int) -> None:
        self.lib.switching_edge(self.c, axis, phase, gates)

    def run(self, edges: Iterable[Edge], until: int) -> None:
        for clock, axis, phase, gates in edges:
            self.advance(clock)
            self.edge(axis, phase, gates)
        self.advance(until)

    def truth(self, axis: int) -> Any:
        truth = self.ffi.new("switching_truth_t *")
        self.lib.switching_truth(self.c, axis, truth)
        return truth

    @property
    def bus(self) -> Any:
        bus = self.ffi.new("switching_bus_t *")
        self.lib.switching_bus(self.c, bus)
        return bus
