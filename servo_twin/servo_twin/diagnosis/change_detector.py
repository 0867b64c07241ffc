"""Detects a change in one set of equations (GLR test), and withdraws it when the data contradict it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from servo_twin.diagnosis.likelihood_ratio import DetectionStatistics, Unknowns
from servo_twin.diagnosis.window import Rows, Sums, Window

_INTERVAL: Final = 1.96  # of 95 %
_SEPARATION_MIN: Final = 6.0  # log likelihood ratio of the reported change over any other change: a constant ...
_SEPARATION_RATIO_MIN: Final = 0.1  # ... plus this fraction of the log likelihood ratio of the reported change
_NONLINEARITY: Final = 0.02  # fraction of a log likelihood ratio that nonlinearity may attribute to a second change
_RESIDUAL_FRACTION_MAX: Final = 0.1  # energy fraction that a single change may leave unexplained, regardless of noise
_BLOCKS_MIN: Final = 5  # fewest blocks for a mean square
_SETTLING_BLOCKS: Final = 10  # blocks after which the start of a change is final

_Array = NDArray[np.float64]
_Sample = TypeVar("_Sample")


class Kind(Enum):
    """Kinds of findings."""

    SINGLE = "single"
    ONE_OF = "one of"
    SEVERAL = "several"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Finding:
    """A detected change."""

    kind: Kind
    changes: tuple[str, ...]  # names of the changes; empty if the cause is unknown
    value: float  # of the first change: relative, torque [N m] or sine of an electrical angle
    low: float  # lower end of its 95 % interval, in the same unit
    high: float  # upper end, in the same unit
    since: int  # start of the change [tick]
    detected: int  # detection [tick]


@dataclass(frozen=True)
class Estimate:
    """One value, with its 95 % interval."""

    name: str
    value: float  # relative change, torque [N m] or sine of an electrical angle
    half_width: float  # half width of the interval, in the same unit; infinite without excitation


_CONSECUTIVE_BLOCKS: Final = {Kind.SINGLE: 1, Kind.SEVERAL: 4, Kind.UNKNOWN: 20, Kind.ONE_OF: 30}
"""Number of consecutive blocks in which a finding must be the most likely one before it is reported."""


class ChangeDetector(Generic[_Sample]):
    """Change detection for the equations of an axis, or for the equation of the bus.

    Parameters
    ----------
    unknowns : Unknowns
        Quantities that may change.
    detect : float
        Detection threshold of the log likelihood ratio.
    residual_limits : ndarray, shape (equations,)
        Largest mean square of the residual, relative to its variance, without a change.
    prior, rows
        See `Window`.
    """

    def __init__(
        self,
        unknowns: Unknowns,
        detect: float,
        residual_limits: _Array,
        prior: _Array,
        rows: Callable[[Sequence[_Sample]], Rows],
    ) -> None:
        self.unknowns = unknowns
        self._detect = detect
        self._residual_limits = residual_limits
        self._window = Window(len(unknowns.names), prior, rows)
        self._age = 0  # blocks since the first sign of a change
        self._likely: tuple[Kind, tuple[str, ...]] | None = None
        self._likely_blocks = 0  # consecutive blocks with the same most likely finding
        self.finding: Finding | None = None  # None: no change

    def clear(self) -> None:
        """Restart the detection, after a change of the twin's plant."""
        self._window.clear()
        self._end()

    def _end(self) -> None:
        """Set the state "no change"."""
        self._age = self._likely_blocks = 0
        self._likely = self.finding = None

    def add(self, tick: int, seconds: float, sample: _Sample) -> bool:
        """Add a sample; True if a block was evaluated. Parameters: see `Window.add`."""
        if not self._window.add(tick, seconds, sample):
            return False
        self._evaluate(tick)
        return True

    def _evaluate(self, tick: int) -> None:
        self._discard_old_blocks()
        sums = self._window.sums()
        statistics = self.unknowns.statistics(sums)
        residual_large = self._has_residual(sums, statistics)
        enough_blocks = len(sums.samples) - statistics.evaluation_block >= _BLOCKS_MIN
        unexplained = residual_large and enough_blocks
        if statistics.log_likelihood_ratio <= self._detect and not unexplained:
            self._withdraw(sums)
            return
        self._age += 1
        if not unexplained and (residual_large or statistics.robust_log_likelihood_ratio <= self._detect):
            return
        finding = self._finding(statistics, unexplained, tick)
        if not self._is_persistent(finding):
            return
        if self.finding is not None:
            same = finding.changes == self.finding.changes and finding.kind == self.finding.kind
            settled = same and self._age > _SETTLING_BLOCKS
            finding = replace(
                finding,
                detected=self.finding.detected if same else tick,
                since=self.finding.since if settled else finding.since,
            )
        self.finding = finding
        if statistics.start_block and len(sums.samples) - statistics.start_block >= _SETTLING_BLOCKS:
            self._window.discard_before(statistics.start_block)

    def _is_persistent(self, finding: Finding) -> bool:
        """True if the finding has been the most likely one for `_CONSECUTIVE_BLOCKS`."""
        likely = finding.kind, finding.changes if finding.kind is Kind.SINGLE else ()
        self._likely_blocks = self._likely_blocks + 1 if likely == self._likely else 1
        self._likely = likely
        return self._likely_blocks >= _CONSECUTIVE_BLOCKS[finding.kind]

    def _discard_old_blocks(self) -> None:
        """Discard the blocks before the reported change changed again, or ended."""
        if self.finding is None or len(self._window.ticks) < 2 * _BLOCKS_MIN:
            return
        sums = self._window.sums()
        if self.finding.kind is Kind.SINGLE:
            vector = self.unknowns.vector(self.unknowns.names.index(self.finding.changes[0]), self.finding.value)
            gain = float(vector @ sums.b[0] - 0.5 * vector @ sums.a[0] @ vector)
            onset = self.unknowns.onset(sums, vector, self._detect + _NONLINEARITY * max(gain, 0.0))
        else:
            onset = len(sums.samples) - _SETTLING_BLOCKS
            if onset <= 0 or not self._unchanged_since(sums, onset):
                return
        if onset and len(sums.samples) - onset >= _BLOCKS_MIN:
            self._window.discard_before(onset)

    def _unchanged_since(self, sums: Sums, block: int) -> bool:
        """True if neither a change nor a residual is significant from this block on."""
        none = np.zeros(len(self.unknowns.names))
        if self.unknowns.onset(Sums(*(part[block:] for part in sums)), none, self._detect) is not None:
            return False
        limits = self._residual_limits * np.maximum(sums.samples[block], 1.0)
        return bool((self._window.residual_energy(sums, block, none) <= limits).all())

    def _has_residual(self, sums: Sums, statistics: DetectionStatistics) -> bool:
        """True if changes of the plant do not explain the residual."""
        block = statistics.evaluation_block
        samples = np.maximum(sums.samples[block], 1.0)
        significant = self._window.residual_energy(sums, block, statistics.joint) > self._residual_limits * samples
        if statistics.log_likelihood_ratio <= self._detect:
            return bool(significant.any())
        large = (
            self._window.residual_energy(sums, block, statistics.vector) > _RESIDUAL_FRACTION_MAX * sums.energy[block]
        )
        return bool((significant & large).any())

    def _withdraw(self, sums: Sums) -> None:
        """Withdraw the finding if the window, which shows no change, contradicts it."""
        if self.finding is None:
            self._end()
            return
        if self.finding.kind is Kind.SINGLE:
            change = self.unknowns.names.index(self.finding.changes[0])
            if not self.unknowns.contradicts(sums, self.unknowns.vector(change, self.finding.value), self._detect):
                return
        elif len(sums.samples) < _SETTLING_BLOCKS:
            return
        self._end()

    def _finding(self, statistics: DetectionStatistics, unexplained: bool, tick: int) -> Finding:
        """Finding for these statistics."""
        names = self.unknowns.names
        since = self._window.ticks[statistics.start_block]
        half = float(np.hypot(_INTERVAL * statistics.deviation, self.unknowns.margins[statistics.change]))
        single = names[statistics.change]
        known = (statistics.value, statistics.value - half, statistics.value + half, since, tick)
        if unexplained:
            return Finding(Kind.UNKNOWN, (), 0.0, 0.0, 0.0, since, tick)
        if statistics.second_ratio > self._detect + _NONLINEARITY * statistics.log_likelihood_ratio:
            return Finding(Kind.SEVERAL, tuple(sorted((single, names[statistics.second]))), *known)
        if (
            statistics.log_likelihood_ratio - statistics.runner_up_ratio
            > _SEPARATION_MIN + _SEPARATION_RATIO_MIN * statistics.log_likelihood_ratio
        ):
            return Finding(Kind.SINGLE, (single,), *known)
        return Finding(Kind.ONE_OF, (single, names[statistics.runner_up]), *known)

    def estimates(self) -> list[Estimate]:
        """Joint estimate of all unknowns, since the last change or over the window."""
        names = self.unknowns.names
        if not self._window.ticks:
            return [Estimate(name, 0.0, float("inf")) for name in names]
        sums = self._window.sums()
        a, b = sums.a[0], sums.b[0]
        excited = np.diag(a) > 0.0
        scale = np.where(excited, 1.0 / np.sqrt(np.where(excited, np.diag(a), 1.0)), 0.0)
        unit = a * np.outer(scale, scale) + np.diag(1e-6 + (~excited).astype(float))
        inverse = np.linalg.inv(unit) * np.outer(scale, scale)
        value = inverse @ b
        noise = _INTERVAL * self.unknowns.spread * np.sqrt(np.diag(inverse))
        half = np.hypot(noise, self.unknowns.margins)
        return [
            Estimate(name, float(v), float(h) if s else float("inf"))
            for name, v, h, s in zip(names, value, half, excited, strict=True)
        ]
