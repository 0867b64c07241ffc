"""The diagnosis of a twin: pairs in, findings and estimates out. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import PERIOD_NS

from servo_twin.diagnosis.channel import Channel, Estimate, Finding, Kind
from servo_twin.diagnosis.hypotheses import Unknowns
from servo_twin.diagnosis.signal_watch import SignalWatch
from servo_twin.diagnosis.signals import CHANGES, NEEDED, AxisEquations, AxisSignals, BusSignal
from servo_twin.diagnosis.thresholds import Thresholds
from servo_twin.lockstep.twin import Pair
from servo_twin.plant import PlantConfig

SUPPLY: Final = "supply"

PLANT_VALUES: Final[Mapping[str, str]] = {
    "resistance": "r_s",
    "flux": "psi_m",
    "inertia": "inertia",
    "friction": "friction",
    "load": "load_torque",
    SUPPLY: "bus.u_source",
}
"""Name in the plant file of what can change, of an axis but for the supply."""

MARGINS: Final = (0.02, 0.01, 0.02, 0.02, 1e-4, 0.01)
"""Per change of an axis, see `Unknowns.margins`."""
BURSTS: Final = (1, 2, 2, 2, 2, 5)
"""Per change of an axis, see `Unknowns.bursts`. A beat of the ripple in voltage d lasts up to 0.5 s; a resistance shows
only in the few blocks with an acceleration."""

_SPEED_MAX: Final = 260.0
"""Beyond the speeds of calibration nothing is judged: voltages come to their limit, which no equation has [rad/s]."""
_BUS_MARGIN: Final = 0.02  # the resistance of the supply is not known well
_SURE: Final = 1.5  # for which something has been found before the twin takes it over [s]
_REMAINDER_MIN: Final = 0.05  # part of a value that is left at least
_GAP: Final = 0.05  # longest time that one sample stands for [s]
_NEEDED: Final = ("u_dc", *(f"{axis_name(axis)}.{name}" for axis in range(AXES) for name in NEEDED))


@dataclass(frozen=True)
class Located:
    """A finding and where it is."""

    axis: int | None  # index; None: the bus
    finding: Finding


class DiagnosisMonitor:
    """Follows the pairs of a twin.

    Parameters
    ----------
    plant : PlantConfig
        The twin's model of the plant.
    thresholds : Thresholds
        What a healthy pair shows.
    """

    def __init__(self, plant: PlantConfig, thresholds: Thresholds) -> None:
        self.thresholds = thresholds
        self.missing = ""  # variables that the telemetry lacks, so that no diagnosis is possible; empty: none
        self.axes = [
            Channel(
                Unknowns(CHANGES, np.array(MARGINS), np.array(noise.spread), BURSTS),
                thresholds.detect,
                np.array(noise.unexplained),
                noise.prior,
                noise.rows,
            )
            for noise in thresholds.axes
        ]
        bus = Unknowns((SUPPLY,), np.array([_BUS_MARGIN]), np.ones(1), (1,))
        self.bus = Channel(bus, thresholds.detect, np.array([np.inf]), np.empty(0), thresholds.bus_rows)
        self.watch = SignalWatch([noise.means for noise in thresholds.axes])  # of signals without an equation
        self.set_plant(plant)

    def set_plant(self, plant: PlantConfig) -> None:
        """The twin has another plant from now on."""
        self.plant = plant  # the twin's model
        self.watch.interrupt()
        self._signals = [AxisSignals(axis, entry) for axis, entry in enumerate(plant.axes)]
        self._bus_signal = BusSignal(plant.bus)
        self._tick: int | None = None
        for _, channel in self._places():
            channel.clear()

    def interrupt(self) -> None:
        """The next pair does not follow on the last one; what is known stays."""
        self._tick = None
        self.watch.interrupt()
        for signals in self._signals:
            signals.interrupt()
        self._bus_signal.interrupt()

    def update(self, pair: Pair) -> bool:
        """Take a pair; returns whether findings or estimates may have changed."""
        if pair.difference or pair.fault:
            self.interrupt()
            return self._leave_to_the_board(pair)
        self.watch.update(pair)
        self.missing = ", ".join(name for name in _NEEDED if name not in pair.real)
        if self.missing:
            return False
        before, self._tick = self._tick, pair.tick
        seconds = 0.0 if before is None else min((pair.tick - before) * PERIOD_NS * 1e-9, _GAP)
        changed = False
        for axis, signals in enumerate(self._signals):
            if abs(pair.real[f"{axis_name(axis)}.speed"]) > _SPEED_MAX:
                signals.interrupt()
                continue
            equations = None if pair.stopping[axis] else signals.update(pair.tick, pair.real, pair.twin)
            if equations is None:
                continue
            changed |= self.axes[axis].add(pair.tick, seconds, equations)
        voltage = self._bus_signal.update(pair.tick, pair.real, pair.twin)
        if voltage is not None:
            changed |= self.bus.add(pair.tick, seconds, voltage)
        return changed

    def _leave_to_the_board(self, pair: Pair) -> bool:
        """Forget what was found of axes with a fault: the board has named the cause. Returns whether there was any."""
        faulty = [self.axes[axis] for axis in range(AXES) if pair.real.get(f"{axis_name(axis)}.faults", 0.0)]
        known = any(channel.finding is not None for channel in faulty)
        for channel in faulty:
            channel.clear()
        return known

    def findings(self) -> list[Located]:
        """What has changed; empty if nothing has."""
        return [Located(axis, channel.finding) for axis, channel in self._places() if channel.finding is not None]

    def _places(self) -> list[tuple[int | None, Channel[AxisEquations] | Channel[float]]]:
        return [*enumerate(self.axes), (None, self.bus)]

    def estimates(self) -> dict[str, Estimate]:
        """Every estimate by its name, such as ``axis1.inertia`` or ``supply``."""
        named = {
            f"{axis_name(axis)}.{one.name}": one
            for axis, channel in enumerate(self.axes)
            for one in channel.estimates()
        }
        return named | {SUPPLY: self.bus.estimates()[0]}

    def adapted(self, tick: int) -> PlantConfig | None:
        """The plant with what has been found for some time; None if there is nothing to take over."""
        plant = self.plant
        for one in self.findings():
            finding = one.finding
            if finding.kind not in (Kind.SINGLE, Kind.SEVERAL) or tick - finding.detected < _SURE / (PERIOD_NS * 1e-9):
                continue
            channel = self.bus if one.axis is None else self.axes[one.axis]
            values = {finding.changes[0]: finding.value}
            if finding.kind is Kind.SEVERAL:
                values = {e.name: e.value for e in channel.estimates() if abs(e.value) > e.half_width}
            for name, value in values.items():
                plant = _with_change(plant, one.axis, name, value)
        return None if plant == self.plant else plant


def _with_change(plant: PlantConfig, axis: int | None, name: str, value: float) -> PlantConfig:
    """The plant after a change that a finding has; one that is no value of a plant leaves it as it is."""
    if name not in PLANT_VALUES:
        return plant
    if axis is None:
        return plant.with_bus(u_source=plant.bus.u_source * (1.0 + value))
    entry = PLANT_VALUES[name]
    old = getattr(plant.axes[axis], entry)
    new = old + value if name == "load" else old * max(1.0 + value, _REMAINDER_MIN)
    return plant.with_axis(axis, **{entry: new})
