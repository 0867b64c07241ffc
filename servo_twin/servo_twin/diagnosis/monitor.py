"""Diagnosis of plant changes: findings and estimates from the pairs of board and twin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import PERIOD_NS

from servo_twin.diagnosis.change_detector import ChangeDetector, Estimate, Finding, Kind
from servo_twin.diagnosis.likelihood_ratio import Unknowns
from servo_twin.diagnosis.signal_monitor import SignalMonitor
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
"""Key in the plant file per change: of the axis, except for the supply."""

MARGINS: Final = (0.02, 0.01, 0.02, 0.02, 1e-4, 0.01)
"""Per entry of `CHANGES`, see `Unknowns.margins`."""
TRANSIENT_BLOCKS: Final = (1, 2, 2, 2, 2, 5)
"""Per entry of `CHANGES`, see `Unknowns.transient_blocks`. A beat of the ripple in voltage d lasts up to 0.5 s; a
resistance is observable only in the few blocks with an acceleration."""

_SPEED_MAX: Final = 260.0
"""No evaluation above the calibrated speed range: the equations do not include the voltage limit [rad/s]."""
_BUS_MARGIN: Final = 0.02  # uncertainty of the supply resistance
_ADOPT_TIME: Final = 1.5  # duration of a finding before it is adopted [s]
_FACTOR_MIN: Final = 0.05  # smallest factor of an adopted value
_GAP: Final = 0.05  # longest time that one sample represents [s]
_NEEDED: Final = ("u_dc", *(f"{axis_name(axis)}.{name}" for axis in range(AXES) for name in NEEDED))


@dataclass(frozen=True)
class LocatedFinding:
    """A finding and its axis."""

    axis: int | None  # index; None: the bus
    finding: Finding


class DiagnosisMonitor:
    """Evaluates the pairs of board and twin.

    Parameters
    ----------
    plant : PlantConfig
        The twin's model of the plant.
    thresholds : Thresholds
        Noise, model error and thresholds of a healthy pair.
    """

    def __init__(self, plant: PlantConfig, thresholds: Thresholds) -> None:
        self.thresholds = thresholds
        self.missing = ""  # required variables missing in the telemetry; if not empty, there is no diagnosis
        self.axes = [
            ChangeDetector(
                Unknowns(CHANGES, np.array(MARGINS), np.array(noise.spread), TRANSIENT_BLOCKS),
                thresholds.detect,
                np.array(noise.unexplained),
                noise.prior,
                noise.rows,
            )
            for noise in thresholds.axes
        ]
        bus = Unknowns((SUPPLY,), np.array([_BUS_MARGIN]), np.ones(1), (1,))
        self.bus = ChangeDetector(bus, thresholds.detect, np.array([np.inf]), np.empty(0), thresholds.bus_rows)
        self.signals = SignalMonitor([noise.means for noise in thresholds.axes])
        self.set_plant(plant)

    def set_plant(self, plant: PlantConfig) -> None:
        """Restart with a changed plant of the twin."""
        self.plant = plant  # the twin's model
        self.signals.interrupt()
        self._signals = [AxisSignals(axis, entry) for axis, entry in enumerate(plant.axes)]
        self._bus_signal = BusSignal(plant.bus)
        self._tick: int | None = None
        for _, detector in self._detectors():
            detector.clear()

    def interrupt(self) -> None:
        """Restart the filters: the next pair does not continue the last one. Findings remain."""
        self._tick = None
        self.signals.interrupt()
        for signals in self._signals:
            signals.interrupt()
        self._bus_signal.interrupt()

    def update(self, pair: Pair) -> bool:
        """Evaluate a pair; True if findings or estimates may have changed."""
        if pair.difference or pair.fault:
            self.interrupt()
            return self._discard_faulted_axes(pair)
        self.signals.update(pair)
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

    def _discard_faulted_axes(self, pair: Pair) -> bool:
        """Discard the findings of axes whose board reports a fault; True if there were any."""
        faulty = [self.axes[axis] for axis in range(AXES) if pair.real.get(f"{axis_name(axis)}.faults", 0.0)]
        had_finding = any(detector.finding is not None for detector in faulty)
        for detector in faulty:
            detector.clear()
        return had_finding

    def findings(self) -> list[LocatedFinding]:
        """Detected changes."""
        return [
            LocatedFinding(axis, detector.finding)
            for axis, detector in self._detectors()
            if detector.finding is not None
        ]

    def _detectors(self) -> list[tuple[int | None, ChangeDetector[AxisEquations] | ChangeDetector[float]]]:
        return [*enumerate(self.axes), (None, self.bus)]

    def estimates(self) -> dict[tuple[int | None, str], Estimate]:
        """Estimates by axis (None: the bus) and change."""
        return {(axis, one.name): one for axis, detector in self._detectors() for one in detector.estimates()}

    def adapted(self, tick: int) -> PlantConfig | None:
        """Plant of the twin with all findings that are older than `_ADOPT_TIME`; None if nothing is to be adopted."""
        plant = self.plant
        for one in self.findings():
            finding = one.finding
            if finding.kind not in (Kind.SINGLE, Kind.SEVERAL) or tick - finding.detected < _ADOPT_TIME / (
                PERIOD_NS * 1e-9
            ):
                continue
            detector = self.bus if one.axis is None else self.axes[one.axis]
            values = {finding.changes[0]: finding.value}
            if finding.kind is Kind.SEVERAL:
                values = {e.name: e.value for e in detector.estimates() if abs(e.value) > e.half_width}
            for name, value in values.items():
                plant = _with_change(plant, one.axis, name, value)
        return None if plant == self.plant else plant


def _with_change(plant: PlantConfig, axis: int | None, name: str, value: float) -> PlantConfig:
    """Plant after a change; unchanged if the change is not a parameter of the plant."""
    if name not in PLANT_VALUES:
        return plant
    if axis is None:
        return plant.with_bus(u_source=plant.bus.u_source * (1.0 + value))
    entry = PLANT_VALUES[name]
    old = getattr(plant.axes[axis], entry)
    new = old + value if name == "load" else old * max(1.0 + value, _FACTOR_MIN)
    return plant.with_axis(axis, **{entry: new})
