"""Python interface of the plant at switching level."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from native_library import Native, c_config
from servo_twin.plant import PlantConfig
from switching_reference import Edge


class Switching:
    """Plant that executes lists of gate edges and records its events."""

    def __init__(self, native: Native, plant: PlantConfig, seed: int = 0) -> None:
        self.ffi, self.lib = native.ffi, native.lib
        self.plant = plant
        self.c = self.ffi.new("switching_t *")
        self.lib.switching_init(self.c, c_config(native, plant, seed))
        self.events: list[tuple[int, int, int, int, bool]] = []
        self.clock = 0

    def spin(self, axis: int, omega: float) -> None:
        """Set the initial speed of a shaft [rad/s]."""
        self.c.axis[axis].inverter.omega = self.c.shaft[axis].speed = omega

    def charge(self, volts: float) -> None:
        """Set the initial voltage of the bus [V]."""
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
        """Take the deferred edges and allow `allowed` more to be deferred; return the number of taken edges."""
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
