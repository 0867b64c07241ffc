"""Current ripple by a ripple of the bus voltage, with and without compensation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.rig import RPM, record, set_up, spinning

NAME: Final = "bus-ripple"
HELP: Final = """\
The supply voltage varies by +-10 % at 100 Hz while an axis turns under load, with and without compensation of the duty
cycles. The reference design has the compensation in its fast loop (2.3, F7), to decouple the current from the bus
voltage, and shows no measurement."""

FREQUENCY: Final = 100.0  # [Hz]
AMPLITUDE: Final = 0.1  # of the supply, relative
SPEED: Final = 1500.0 * RPM  # [rad/s]
LOAD: Final = 1.0  # load torque, as current [A]
DISCHARGE_FRACTION: Final = 0.75
"""Fraction of the load current for discharging the capacitor with the falling supply, which cannot absorb energy."""

SETTLE: Final = 0.8  # [s]
MEASURED: Final = 0.5  # [s]
SHOWN: Final = 0.05  # [s]
RIPPLE_RATIO_MAX: Final = 0.25  # ripple with compensation relative to the ripple without
NOMINAL: Final = 2.0  # [A]
RIPPLE_MAX: Final = 0.01  # relative to the nominal current


def capacitance(plant: PlantConfig, axis: int) -> float:
    """Capacitance that the load can discharge as fast as the supply falls, at most that of the plant [F]."""
    current = LOAD * plant.axes[axis].torque_constant * SPEED / plant.bus.u_source
    fastest = 2.0 * math.pi * FREQUENCY * AMPLITUDE * plant.bus.u_source
    return min(DISCHARGE_FRACTION * current / fastest, plant.bus.capacitance)


def amplitude(signal: NDArray[np.float64], frequency: float) -> float:
    """Amplitude of one frequency [Hz] in a signal (samples,) with whole periods, in its unit."""
    wave = np.exp(-2j * np.pi * frequency * TICK * np.arange(signal.size))
    return float(2.0 * abs(np.mean((signal - signal.mean()) * wave)))


def turn(plant: PlantConfig, seed: int, axis: int, compensated: bool) -> Trace:
    """Rotate an axis under load with a ripple of the supply."""
    plant = plant.with_bus(capacitance=capacitance(plant, axis))
    volts = plant.bus.u_source
    acceleration = {"acceleration_limit": 4.0 * SPEED / SETTLE}
    with spinning(plant, seed) as board:
        set_up(board, axis, "SPEED", SPEED, parameters=acceleration, BUS_COMPENSATION=compensated)
        # A load, because braking would raise the voltage of the small capacitor.
        board.set_load(axis, LOAD * plant.axes[axis].torque_constant)
        record(board, [axis], 0.5 * SETTLE)

        def act(k: int) -> None:
            board.set_supply(volts + AMPLITUDE * volts * math.sin(2.0 * math.pi * FREQUENCY * k * TICK))

        return record(board, [axis], 0.5 * SETTLE + MEASURED, act)[axis].part(0.5 * SETTLE)


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both axes, with and without: true current, true speed and bus at the frequency of the ripple."""
    smallest = 1e3 * min(capacitance(plant, axis) for axis in range(AXES))
    yield f"{SPEED / RPM:g} rpm, load of {LOAD:g} A, bus capacitor {smallest:.2g} mF, ripple at {FREQUENCY:g} Hz"
    for axis in range(AXES):
        name = axis_name(axis)
        both = [turn(plant, seed, axis, compensated) for compensated in (True, False)]
        with_compensation, without = both
        bus = 100.0 * amplitude(with_compensation["u_dc"], FREQUENCY) / plant.bus.u_source
        currents = [amplitude(r["i_q_true"], FREQUENCY) for r in both]
        speeds = [amplitude(r["omega"], FREQUENCY) / RPM for r in both]
        ratio, part = currents[0] / max(currents[1], 1e-9), 100.0 * currents[0] / NOMINAL
        judge = Judge(f"{name}, ", "F7: compensated")
        yield judge("ripple of the bus", bus, "%", 80.0 * AMPLITUDE, 110.0 * AMPLITUDE, reference="10 %")
        yield judge("current ripple with / without compensation", ratio, maximum=RIPPLE_RATIO_MAX)
        yield judge("current ripple with compensation", part, "% of 2 A", maximum=100.0 * RIPPLE_MAX)
        yield (
            f"{name}: i_q ripple {1e3 * currents[0]:.3g} mA with, {1e3 * currents[1]:.3g} mA without; "
            f"speed ripple {speeds[0]:.3g} and {speeds[1]:.3g} rpm"
        )
        shown = {"without": _shown(without), "with compensation": _shown(with_compensation)}
        curves = [Curve(label, _milliseconds(r), r["i_q_true"]) for label, r in shown.items()]
        yield Panel(f"{name}: true i_q", "time [ms]", "i_q [A]", curves)
    last = _shown(with_compensation)
    yield Panel("bus voltage", "time [ms]", "bus [V]", [Curve("bus", _milliseconds(last), last["u_dc"])])


def _shown(recording: Trace) -> Trace:
    return recording.part(0.5 * SETTLE, 0.5 * SETTLE + SHOWN)


def _milliseconds(part: Trace) -> NDArray[np.float64]:
    return np.asarray(1e3 * (part.time - part.time[0]))
