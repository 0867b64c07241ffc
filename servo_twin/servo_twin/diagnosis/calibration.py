"""Calibration: noise, model error and detection threshold from runs without a change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.quantity import Quantity
from servo_msgs_py.units import PERIOD_NS

from servo_twin.diagnosis.likelihood_ratio import Unknowns
from servo_twin.diagnosis.monitor import MARGINS, TRANSIENT_BLOCKS
from servo_twin.diagnosis.signal_monitor import MONITORED, SignalMeans
from servo_twin.diagnosis.signals import (
    ALIASES,
    CHANGES,
    EQUATIONS,
    TORQUE,
    VOLTAGE_D,
    VOLTAGE_Q,
    AxisEquations,
    AxisSignals,
    BusSignal,
)
from servo_twin.diagnosis.thresholds import BINS, AxisNoise, Thresholds, ThresholdsError, bin_of
from servo_twin.diagnosis.window import BLOCK, Window
from servo_twin.lockstep.twin import Pair
from servo_twin.plant import PlantConfig

FALSE_ALARM_HOURS: Final = 48.0
"""Target of the mean time between false alarms [h of motion]."""

DURATION: Final = Quantity(unit="s", minimum=60.0, maximum=1e5)
"""Board time of a calibration."""

_SPAN: Final = 100  # blocks per maximum of the likelihood ratio
_MEAN_SPAN: Final = 10.0  # time per maximum of the running means [s]
_DETECT_MIN: Final = 12.0
_SAMPLES_MIN: Final = 100  # fewest samples for the noise of a bin
_SPANS_MIN: Final = 20  # fewest spans for the fit of the tail
_BLOCKS_MIN: Final = 5  # fewest blocks for a mean square
_INFLATION: Final = 2.0  # of the largest measured mean square of the residual

_Array = NDArray[np.float64]
_Span = Window[AxisEquations]


class Calibrator:
    """Calculates thresholds from the pairs of a healthy run.

    Parameters
    ----------
    plant : PlantConfig
        The twin's model of the plant.
    """

    def __init__(self, plant: PlantConfig) -> None:
        self._signals = [AxisSignals(axis, entry) for axis, entry in enumerate(plant.axes)]
        self._bus = BusSignal(plant.bus)
        self._equations: list[list[tuple[int, AxisEquations]]] = [[] for _ in range(AXES)]
        self._means = SignalMeans()
        self._mean_maxima: list[_Array] = []
        self._mean_begin: int | None = None
        self._voltages: list[float] = []
        self._seconds = 0.0
        self._tick: int | None = None

    def add(self, pair: Pair) -> None:
        """Add a pair."""
        if pair.difference or pair.fault:
            self.interrupt()
            return
        if self._tick is not None:
            self._seconds += (pair.tick - self._tick) * PERIOD_NS * 1e-9
        self._tick = pair.tick
        self._add_means(pair)
        for axis, signals in enumerate(self._signals):
            equations = None if pair.stopping[axis] else signals.update(pair.tick, pair.real, pair.twin)
            if equations is not None:
                self._equations[axis].append((pair.tick, equations))
        voltage = self._bus.update(pair.tick, pair.real, pair.twin)
        if voltage is not None:
            self._voltages.append(voltage)

    def _add_means(self, pair: Pair) -> None:
        means = self._means.update(pair)
        if means is None:
            return
        if self._mean_begin is None or pair.tick - self._mean_begin > _MEAN_SPAN / (PERIOD_NS * 1e-9):
            self._mean_begin = pair.tick
            self._mean_maxima.append(np.zeros_like(means))
        np.maximum(self._mean_maxima[-1], np.abs(means), out=self._mean_maxima[-1])

    def interrupt(self) -> None:
        """Restart the filters: the next pair does not continue the last one."""
        self._means.interrupt()
        self._mean_begin = self._tick = None
        for signals in self._signals:
            signals.interrupt()
        self._bus.interrupt()

    def merge(self, other: Calibrator) -> None:
        """Merge the data of another run."""
        for own, others in zip(self._equations, other._equations, strict=True):
            own += others
        self._voltages += other._voltages
        self._mean_maxima += other._mean_maxima
        self._seconds += other._seconds

    def thresholds(self, hours: float = FALSE_ALARM_HOURS) -> Thresholds:
        """Thresholds from all added pairs.

        Parameters
        ----------
        hours : float
            Mean time between false alarms [h of motion].

        Raises
        ------
        ThresholdsError
            If an axis has moved too little, or the bus was always above its supply.
        """
        axes: list[AxisNoise] = []
        maxima: list[float] = []
        for axis, entries in enumerate(self._equations):
            if len(entries) < 2 * _SAMPLES_MIN:
                raise ThresholdsError(
                    f"{axis_name(axis)} moved too little: move both axes back and forth during the calibration"
                )
            noise = _noise([equations for _, equations in entries])
            spans, spread = _spans(entries, noise)
            mean_maxima = np.array([one[axis] for one in self._mean_maxima])
            limits = tuple(_tail(mean_maxima[:, k], hours * 3600.0 / _MEAN_SPAN) for k in range(len(MONITORED)))
            ratios, squares = _maxima(spans, np.array(spread))
            maxima += ratios
            unexplained = tuple((_INFLATION * squares).tolist())
            axes.append(replace(noise, spread=spread, unexplained=unexplained, means=limits))
        if len(maxima) < _SPANS_MIN:
            raise ThresholdsError(
                f"{len(maxima) * _SPAN * BLOCK:.0f} s of motion are not enough: move for at least "
                f"{_SPANS_MIN * _SPAN * BLOCK:.0f} s"
            )
        span_hours = _SPAN * BLOCK / 3600.0
        voltages = np.array(self._voltages)
        if len(voltages) < _SAMPLES_MIN:
            raise ThresholdsError("the bus voltage is always raised by braking: brake less during the calibration")
        return Thresholds(
            axes=tuple(axes),
            bus_noise=float(voltages.std()),
            bus_baseline=float(voltages.mean()),
            detect=max(_tail(np.array(maxima), hours / span_hours * AXES), _DETECT_MIN),
            false_alarm_hours=hours,
            run_hours=self._seconds / 3600.0,
        )


def _noise(entries: Sequence[AxisEquations]) -> AxisNoise:
    """Alias coefficients, noise and baseline of an axis."""
    y, phi, z = (np.array(part) for part in zip(*((e.y, e.phi, e.alias) for e in entries), strict=True))
    share = np.array([e.share for e in entries])
    bins = bin_of(np.array([e.current for e in entries]), np.array([e.speed for e in entries]))
    alias = np.linalg.lstsq(z.reshape(-1, len(ALIASES)), y.ravel(), rcond=None)[0]
    without_alias = y - z @ alias
    baseline = np.zeros(len(CHANGES))
    for _ in range(3):
        residual = without_alias - phi @ baseline
        torque = _root_mean_square(residual[share > 0.0, TORQUE])
        voltages = {k: _by_bin(residual[:, k], bins) for k in (VOLTAGE_Q, VOLTAGE_D)}
        weight = np.stack([share / torque**2, *(voltages[k][bins] ** -2 for k in (VOLTAGE_Q, VOLTAGE_D))], axis=1)
        information = np.einsum("nei,ne,nej->ij", phi, weight, phi)
        baseline = np.linalg.solve(information, np.einsum("nei,ne,ne->i", phi, weight, without_alias))
    return AxisNoise(
        alias=tuple(alias.tolist()),
        torque=torque,
        voltage_q=tuple(voltages[VOLTAGE_Q].tolist()),
        voltage_d=tuple(voltages[VOLTAGE_D].tolist()),
        baseline=tuple(baseline.tolist()),
        spread=(1.0,) * len(CHANGES),
        unexplained=(1.0,) * len(EQUATIONS),
        means=(1.0,) * len(MONITORED),
    )


def _root_mean_square(values: _Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _by_bin(residual: _Array, bins: NDArray[np.int64]) -> _Array:
    """RMS per bin; with fewer than `_SAMPLES_MIN` samples, the RMS of all bins."""
    whole = _root_mean_square(residual[residual != 0.0])
    parts = [residual[(bins == k) & (residual != 0.0)] for k in range(BINS)]
    return np.array([_root_mean_square(part) if len(part) >= _SAMPLES_MIN else whole for part in parts])


def _spans(entries: Sequence[tuple[int, AxisEquations]], noise: AxisNoise) -> tuple[list[_Span], tuple[float, ...]]:
    """Consecutive windows of `_SPAN` blocks, and the spread of their estimates."""
    spans: list[_Span] = []
    window = Window(len(CHANGES), noise.prior, noise.rows)
    before: int | None = None
    for tick, equations in entries:
        seconds = 0.0 if before is None else min(max(tick - before, 0) * PERIOD_NS * 1e-9, 0.05)
        before = tick
        full = window.add(tick, seconds, equations)
        if full and len(window.ticks) == _SPAN:
            spans.append(window)
            window = Window(len(CHANGES), noise.prior, noise.rows)
    if len(spans) < 2:
        return spans, (1.0,) * len(CHANGES)
    units: list[_Array] = []  # estimates of tenths of a span, relative to their deviations for white noise
    for span in spans:
        sums = span.sums()
        tenths = range(0, len(sums.samples), _SPAN // 10)
        a, b = (np.add.reduceat(part.sum(axis=1), tenths) for part in (sums.parts_a, sums.parts_b))
        a, b = a[:, : len(CHANGES), : len(CHANGES)], b[:, : len(CHANGES)]
        diagonal = np.einsum("nii->ni", a)
        units.append(b / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))
    spread = np.concatenate(units).std(axis=0)
    return spans, tuple(float(max(x, 1.0)) for x in spread)


def _maxima(spans: Sequence[_Span], spread: _Array) -> tuple[list[float], _Array]:
    """Largest likelihood ratio per span, and largest mean square per equation over all spans and start blocks."""
    unknowns = Unknowns(CHANGES, np.array(MARGINS), spread, TRANSIENT_BLOCKS)
    ratios: list[float] = []
    squares = np.ones(len(EQUATIONS))
    for span in spans:
        sums = span.sums()
        ratios.append(unknowns.strongest(sums))
        long_enough = slice(None, max(len(sums.samples) - _BLOCKS_MIN, 1))
        squares = np.maximum(
            squares, (sums.energy[long_enough] / np.maximum(sums.samples[long_enough], 1.0)).max(axis=0)
        )
    return ratios, squares


def _tail(maxima: _Array, count: float) -> float:
    """Level that `count` maxima exceed once on average, from an exponential fit to the upper half of the maxima."""
    middle = float(np.median(maxima))
    excess = maxima[maxima > middle] - middle
    slope = float(excess.mean()) if len(excess) else 0.0
    return middle + slope * math.log(0.5 * count)
