"""Current ripple that a rippling bus leaves, with and without compensation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.rig import (
    RPM,
    TICK,
    Recording,
    choose_mode,
    command_speed,
    features,
    set_axis,
    spinning,
    watch,
)
from servo_twin.plant import PlantConfig

NAME: Final = "bus-ripple"
HELP: Final = """\
The supply swings by 10 % up and down at 100 Hz while an axis turns under load; the duties follow it or do not.
The reference design has the compensation in its fast loop (2.3, F7) and shows no measurement: it is there so that the
current does not see the bus."""

FREQUENCY: Final = 100.0  # [Hz]
SWING: Final = 0.1  # of the supply, up and down
SPEED: Final = 1500.0 * RPM
LOAD: Final = 1.0  # torque of the load, as current [A]
FOLLOWS: Final = 0.75
"""Part of the load's current that may go into following the supply down: the source takes no energy back."""

SETTLE: Final = 0.8  # [s]
MEASURED: Final = 0.5  # [s]
SHOWN: Final = 0.05  # [s]
LEFT_MOST: Final = 0.25  # of the ripple without compensation
NOMINAL: Final = 2.0  # [A]
RIPPLE_MOST: Final = 0.01  # of the nominal current


@dataclass(frozen=True)
class Ripple:
    """Amplitudes at the frequency of the ripple.

    Attributes
    ----------
    current, speed, bus : float
        Of the true torque current [A], the true speed [rad/s] and the bus [V].
    noise : float
        Standard deviation of the true torque current, all frequencies [A].
    recording : Recording
        The measured part.
    """

    current: float
    speed: float
    bus: float
    noise: float
    recording: Recording


def capacitance(plant: PlantConfig, axis: int) -> float:
    """Capacitor that the load can empty as fast as the supply falls, at most the plant's [F]."""
    current = LOAD * plant.axes[axis].torque_constant * SPEED / plant.bus.u_source
    fastest = 2.0 * math.pi * FREQUENCY * SWING * plant.bus.u_source
    return min(FOLLOWS * current / fastest, plant.bus.capacitance)


def amplitude(signal: NDArray[np.float64], frequency: float) -> float:
    """Amplitude of one frequency in a signal that covers whole periods of it."""
    wave = np.exp(-2j * np.pi * frequency * TICK * np.arange(signal.size))
    return float(2.0 * abs(np.mean((signal - signal.mean()) * wave)))


def turn(plant: PlantConfig, seed: int, axis: int, compensated: bool) -> Ripple:
    """Turn an axis under load on a rippling bus."""
    plant = plant.with_bus(capacitance=capacitance(plant, axis))
    volts = plant.bus.u_source
    with spinning(plant, seed) as board:
        features(board, axis, BUS_COMPENSATION=compensated)
        set_axis(board, "param.acceleration_limit", axis, 4.0 * SPEED / SETTLE)
        choose_mode(board, axis, "SPEED")
        command_speed(board, axis, SPEED)
        board.set_load(axis, LOAD * plant.axes[axis].torque_constant)  # braking would lift a bus that is so small
        watch(board, [axis], 0.5 * SETTLE)
        swings = SWING * volts

        def act(k: int) -> None:
            board.set_supply(volts + swings * math.sin(2.0 * math.pi * FREQUENCY * k * TICK))

        whole = watch(board, [axis], 0.5 * SETTLE + MEASURED, act)[axis]
    part = whole.part(0.5 * SETTLE)
    return Ripple(
        current=amplitude(part.i_q_true, FREQUENCY),
        speed=amplitude(part.omega, FREQUENCY),
        bus=amplitude(part.u_dc, FREQUENCY),
        noise=float(part.i_q_true.std()),
        recording=part,
    )


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Both axes, with and without."""
    rows: list[Row] = []
    panels: list[Panel] = []
    smallest = 1e3 * min(capacitance(plant, axis) for axis in range(AXES))
    notes = [f"{SPEED / RPM:g} rpm, load of {LOAD:g} A, bus capacitor {smallest:.2g} mF, ripple at {FREQUENCY:g} Hz"]
    for axis in range(AXES):
        name = axis_name(axis)
        with_it, without = turn(plant, seed, axis, True), turn(plant, seed, axis, False)
        rows.extend(_rows(name, plant.bus.u_source, with_it, without))
        notes.append(
            f"{name}: i_q ripple {1e3 * with_it.current:.3g} mA with, {1e3 * without.current:.3g} mA without; "
            f"speed ripple {with_it.speed / RPM:.3g} and {without.speed / RPM:.3g} rpm"
        )
        panels.append(_panel(name, with_it, without))
    bus = with_it.recording.part(0.5 * SETTLE, 0.5 * SETTLE + SHOWN)
    time = 1e3 * (bus.time - bus.time[0])
    panels.append(Panel("the bus", "time [ms]", "bus [V]", (Curve("bus", time, bus.u_dc),)))
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _rows(name: str, volts: float, with_it: Ripple, without: Ripple) -> tuple[Row, ...]:
    return (
        Row(f"{name}, ripple of the bus", "10 %", 100.0 * with_it.bus / volts, "%", Bound(80.0 * SWING, 110.0 * SWING)),
        Row(
            f"{name}, current ripple, with over without",
            "F7: compensated",
            with_it.current / max(without.current, 1e-9),
            "",
            Bound(most=LEFT_MOST),
        ),
        Row(
            f"{name}, current ripple with",
            "F7: compensated",
            100.0 * with_it.current / NOMINAL,
            "% of 2 A",
            Bound(most=100.0 * RIPPLE_MOST),
        ),
    )


def _panel(name: str, with_it: Ripple, without: Ripple) -> Panel:
    curves: list[Curve] = []
    for label, ripple in (("without", without), ("with compensation", with_it)):
        part = ripple.recording.part(0.5 * SETTLE, 0.5 * SETTLE + SHOWN)
        curves.append(Curve(label, 1e3 * (part.time - part.time[0]), part.i_q_true))
    return Panel(f"{name}: true i_q", "time [ms]", "i_q [A]", tuple(curves))
