"""From the evidence of one set of equations to a finding that stays until the board speaks against it. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from servo_twin.diagnosis.hypotheses import Evidence, Unknowns
from servo_twin.diagnosis.window import Rows, Sums, Window

_INTERVAL: Final = 1.96  # of 95 %
_SEPARATE: Final = 6.0  # by which the likelihood of the change that is named exceeds that of any other,
_SEPARATE_PART: Final = 0.1  # and by which part of itself
_SEVERAL: Final = 0.02  # part of what the first change explains that its own nonlinearity may leave to others
_LEFT: Final = 0.1  # part of the residual that a single change may leave, whatever the noise
_ENOUGH: Final = 5  # blocks from which a mean square is one
_SETTLED: Final = 10  # blocks after which the time of a change is final

_Array = NDArray[np.float64]
_Sample = TypeVar("_Sample")


class Kind(Enum):
    """What is known of a change."""

    SINGLE = "single"
    ONE_OF = "one of"
    SEVERAL = "several"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Finding:
    """Something has changed."""

    kind: Kind
    changes: tuple[str, ...]  # names of the changes; empty if it is unknown
    value: float  # of the first change: relative, torque [N m] or electrical angle [rad]
    low: float  # lower end of its 95 % interval, in the same unit
    high: float  # upper end, in the same unit
    since: int  # tick of its beginning
    detected: int  # tick of its detection


@dataclass(frozen=True)
class Estimate:
    """One value, with its 95 % interval."""

    name: str
    value: float  # relative change, torque [N m] or electrical angle [rad]
    half_width: float  # of its interval, in the same unit; infinite without excitation


_BLOCKS_MIN: Final = {Kind.SINGLE: 1, Kind.SEVERAL: 4, Kind.UNKNOWN: 20, Kind.ONE_OF: 30}
"""For how many blocks something has to be the most likely before it is said."""


class Channel(Generic[_Sample]):
    """One set of equations: those of an axis, or that of the bus.

    Parameters
    ----------
    unknowns : Unknowns
        What may change.
    detect : float
        Logarithm of the likelihood ratio from which a change is one.
    unexplained : ndarray, shape (equations,)
        Mean square over its variance from which something is left to explain.
    prior, rows
        See `Window`.
    """

    def __init__(
        self,
        unknowns: Unknowns,
        detect: float,
        unexplained: _Array,
        prior: _Array,
        rows: Callable[[Sequence[_Sample]], Rows],
    ) -> None:
        self.unknowns = unknowns
        self._detect = detect
        self._unexplained = unexplained
        self._window = Window(len(unknowns.names), prior, rows)
        self._age = 0  # blocks since the first sign of a change
        self._likely: tuple[Kind, tuple[str, ...]] | None = None
        self._likely_blocks = 0  # for which that has been the most likely
        self.finding: Finding | None = None  # None: nothing has changed

    def clear(self) -> None:
        """Begin anew: the twin has another plant."""
        self._window.clear()
        self._end()

    def _end(self) -> None:
        """Nothing has changed, or not any more."""
        self._age = self._likely_blocks = 0
        self._likely = self.finding = None

    def add(self, tick: int, seconds: float, sample: _Sample) -> bool:
        """Add a sample; returns whether there is something new to say. Arguments as of `Window.add`."""
        if not self._window.add(tick, seconds, sample):
            return False
        self._judge(tick)
        return True

    def _judge(self, tick: int) -> None:
        self._forget_what_is_over()
        sums = self._window.sums()
        found = self.unknowns.evidence(sums)
        misfit = self._misfit(sums, found)
        enough = len(sums.samples) - found.block >= _ENOUGH
        left = misfit and enough
        if found.ratio <= self._detect and not left:
            self._calm(sums)
            return
        self._age += 1
        if not left and (misfit or found.rest <= self._detect):
            return
        finding = self._finding(found, left, tick)
        if not self._lasts(finding):
            return
        if self.finding is not None:
            same = finding.changes == self.finding.changes and finding.kind == self.finding.kind
            settled = same and self._age > _SETTLED
            finding = replace(
                finding,
                detected=self.finding.detected if same else tick,
                since=self.finding.since if settled else finding.since,
            )
        self.finding = finding
        if found.since and len(sums.samples) - found.since >= _SETTLED:
            self._window.forget_before(found.since)

    def _lasts(self, finding: Finding) -> bool:
        """Whether this has been the most likely for long enough."""
        likely = finding.kind, finding.changes if finding.kind is Kind.SINGLE else ()
        self._likely_blocks = self._likely_blocks + 1 if likely == self._likely else 1
        self._likely = likely
        return self._likely_blocks >= _BLOCKS_MIN[finding.kind]

    def _forget_what_is_over(self) -> None:
        """Keep only what has come since the change that is known has become another one, or none."""
        if self.finding is None or len(self._window.ticks) < 2 * _ENOUGH:
            return
        sums = self._window.sums()
        if self.finding.kind is Kind.SINGLE:
            vector = self.unknowns.vector(self.unknowns.names.index(self.finding.changes[0]), self.finding.value)
            gain = float(vector @ sums.b[0] - 0.5 * vector @ sums.a[0] @ vector)
            later = self.unknowns.later(sums, vector, self._detect + _SEVERAL * max(gain, 0.0))
        else:
            later = len(sums.samples) - _SETTLED
            if later <= 0 or not self._nothing_since(sums, later):
                return
        if later and len(sums.samples) - later >= _ENOUGH:
            self._window.forget_before(later)

    def _nothing_since(self, sums: Sums, block: int) -> bool:
        """Whether the blocks from this one on look like those of a healthy pair."""
        none = np.zeros(len(self.unknowns.names))
        if self.unknowns.later(Sums(*(part[block:] for part in sums)), none, self._detect) is not None:
            return False
        limits = self._unexplained * np.maximum(sums.samples[block], 1.0)
        return bool((self._window.left(sums, block, none) <= limits).all())

    def _misfit(self, sums: Sums, found: Evidence) -> bool:
        """Whether the residual is larger than changes of the plant explain."""
        samples = np.maximum(sums.samples[found.block], 1.0)
        beyond = self._window.left(sums, found.block, found.joint) > self._unexplained * samples
        if found.ratio <= self._detect:
            return bool(beyond.any())
        part = self._window.left(sums, found.block, found.vector) > _LEFT * sums.energy[found.block]
        return bool((beyond & part).any())

    def _calm(self, sums: Sums) -> None:
        """No sign of a change in the window: whether the last finding is over."""
        if self.finding is None:
            self._end()
            return
        if self.finding.kind is Kind.SINGLE:
            change = self.unknowns.names.index(self.finding.changes[0])
            if not self.unknowns.rejects(sums, self.unknowns.vector(change, self.finding.value), self._detect):
                return
        elif len(sums.samples) < _SETTLED:
            return
        self._end()

    def _finding(self, found: Evidence, left: bool, tick: int) -> Finding:
        """The most likely."""
        names = self.unknowns.names
        since = self._window.ticks[found.since]
        half = float(np.hypot(_INTERVAL * found.deviation, self.unknowns.margins[found.change]))
        single = names[found.change]
        known = (found.value, found.value - half, found.value + half, since, tick)
        if left:
            return Finding(Kind.UNKNOWN, (), 0.0, 0.0, 0.0, since, tick)
        if found.second_ratio > self._detect + _SEVERAL * found.ratio:
            return Finding(Kind.SEVERAL, tuple(sorted((single, names[found.second]))), *known)
        if found.ratio - found.rival_ratio > _SEPARATE + _SEPARATE_PART * found.ratio:
            return Finding(Kind.SINGLE, (single,), *known)
        return Finding(Kind.ONE_OF, (single, names[found.rival]), *known)

    def estimates(self) -> list[Estimate]:
        """Of everything together, since the last change or over the window."""
        names = self.unknowns.names
        if not self._window.ticks:
            return [Estimate(name, 0.0, float("inf")) for name in names]
        sums = self._window.sums()
        a, b = sums.a[0], sums.b[0]
        seen = np.diag(a) > 0.0
        scale = np.where(seen, 1.0 / np.sqrt(np.where(seen, np.diag(a), 1.0)), 0.0)
        unit = a * np.outer(scale, scale) + np.diag(1e-6 + (~seen).astype(float))
        inverse = np.linalg.inv(unit) * np.outer(scale, scale)
        value = inverse @ b
        noise = _INTERVAL * self.unknowns.spread * np.sqrt(np.diag(inverse))
        half = np.hypot(noise, self.unknowns.margins)
        return [
            Estimate(name, float(v), float(h) if s else float("inf"))
            for name, v, h, s in zip(names, value, half, seen, strict=True)
        ]
