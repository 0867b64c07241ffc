"""Which single change explains the residual best: likelihood ratios over all changes and all times since. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servo_twin.diagnosis.window import Sums

_TRANSIENT: Final = 3  # blocks after a change in which the loops may still settle: what they show does not count later

_Array = NDArray[np.float64]

_ANGLE: Final = "encoder_angle"  # judged together with the flux that it takes from the q axis


def _flux_lost(sine: float | _Array) -> _Array:
    """Relative flux that the q axis seems to lose when the encoder is off by an angle with this sine."""
    return np.asarray(np.sqrt(np.maximum(1.0 - np.square(sine), 0.0)) - 1.0)


def _burst_part(a: _Array, b: _Array, blocks: int) -> float:
    """Part of the evidence for one change that its strongest blocks contribute, from 0 to 1.

    Parameters
    ----------
    a, b : ndarray, shape (blocks,)
        Its information and its right side since the beginning of each block; the first ones are of all blocks.
    blocks : int
        How many of them.
    """
    value = b[0] / a[0]
    since = value * b - 0.5 * value**2 * a
    alone = since - np.append(since[1:], 0.0)
    return float(min(np.sort(alone)[-blocks:].sum() / since[0], 1.0)) if since[0] > 0.0 else 1.0


@dataclass(frozen=True)
class Evidence:
    """What a window says."""

    since: int  # first block of the change
    block: int  # block from which it was judged
    change: int  # index into `CHANGES` of the change that explains most
    value: float  # estimate of this change
    deviation: float  # standard deviation of the estimate
    ratio: float  # logarithm of its likelihood ratio against no change
    rest: float  # the same without the strongest blocks, see `Unknowns.bursts`: a transient is no change
    rival: int  # the change that explains most after it, alone
    rival_ratio: float  # of that one, since the same block
    second: int  # the change that explains most of what is left
    second_ratio: float  # how much that is, without the strongest blocks
    vector: _Array  # (unknowns,), all unknowns at that change
    joint: _Array  # (unknowns,), all unknowns at both changes


@dataclass(frozen=True)
class Unknowns:
    """What may change in one set of equations."""

    names: tuple[str, ...]
    margins: _Array  # (unknowns,), error of the model without any change; an estimate within it explains nothing
    spread: _Array  # (unknowns,), standard deviation of an estimate over that of white noise
    bursts: Sequence[int]  # (unknowns,), blocks of a transient like a change; so many, the strongest, are no evidence

    def vector(self, change: int, value: float) -> _Array:
        """All unknowns (unknowns,) at a single change; an encoder that has slipped also takes flux from the q axis."""
        vector = np.zeros(len(self.names))
        vector[change] = value
        if self.names[change] == _ANGLE:
            vector[self.names.index("flux")] = _flux_lost(value)
        return vector

    def _singles(self, sums: Sums) -> tuple[_Array, _Array]:
        """As `_ratios`, since every block, with the flux that an encoder's angle takes from the q axis."""
        values, ratios = self._ratios(np.einsum("nii->ni", sums.a), sums.b)
        if _ANGLE in self.names:
            angle, flux = self.names.index(_ANGLE), self.names.index("flux")
            lost = _flux_lost(values[:, angle])
            left = sums.b[:, flux] - sums.a[:, angle, flux] * values[:, angle] - 0.5 * sums.a[:, flux, flux] * lost
            ratios[:, angle] += np.where(ratios[:, angle] > 0.0, lost * left, 0.0) / self.spread[flux] ** 2
        return values, ratios

    def _ratios(self, a: _Array, b: _Array) -> tuple[_Array, _Array]:
        """Estimates of single changes and logarithms of their likelihood ratios.

        Parameters
        ----------
        a, b : ndarray, shape (..., unknowns)
            Diagonal of the information, and right sides.
        """
        known = a > 0.0
        value = np.where(known, b / np.where(known, a, 1.0), 0.0)
        beyond = np.maximum(np.abs(value) - self.margins, 0.0)
        return value, 0.5 * beyond**2 * a / self.spread**2

    def strongest(self, sums: Sums) -> float:
        """Largest logarithm of a likelihood ratio of any change since any block."""
        return float(self._singles(sums)[1][:-1].max())

    def evidence(self, sums: Sums) -> Evidence:
        """The single change, and the block since which it is there, that explain most."""
        values, ratios = self._singles(sums)
        ratios = ratios[: max(len(ratios) - 1, 1)]  # the last block alone is no evidence
        block, change = (int(k) for k in np.unravel_index(int(np.argmax(ratios)), ratios.shape))
        since = block
        if len(sums.samples) - block > 2 * _TRANSIENT:
            block += _TRANSIENT
            change = int(np.argmax(ratios[block]))
        a, b = sums.a[block], sums.b[block]
        if not a[change, change] > 0.0:
            none = np.zeros(len(self.names))
            return Evidence(since, block, change, 0.0, float("inf"), 0.0, 0.0, change, 0.0, change, 0.0, none, none)
        value, ratio = float(values[block, change]), float(ratios[block, change])
        vector = self.vector(change, value)
        left = b - a @ vector
        diagonal = np.diag(a)
        reduced = diagonal - a[change] ** 2 / a[change, change]
        reduced = np.where(reduced > 1e-6 * diagonal, reduced, 0.0)
        reduced[change] = 0.0
        seconds, second_ratios = self._ratios(reduced, left)
        second = int(np.argmax(second_ratios))
        rest = sums.b[block:, second] - sums.a[block:, second] @ vector
        second_part = (
            _burst_part(sums.a[block:, second, second], rest, self.bursts[second])
            if second_ratios[second] > 0.0
            else 0.0
        )
        rivals = np.where(np.arange(len(self.names)) == change, -1.0, ratios[block])
        rival = int(np.argmax(rivals))
        joint = vector.copy()  # of both changes together
        joint[second] += seconds[second]
        joint[change] -= seconds[second] * a[change, second] / a[change, change]
        return Evidence(
            since,
            block,
            change,
            value,
            float(self.spread[change] / np.sqrt(a[change, change])),
            ratio,
            ratio * (1.0 - _burst_part(sums.a[block:, change, change], sums.b[block:, change], self.bursts[change])),
            rival,
            float(max(rivals[rival], 0.0)),
            second,
            float(second_ratios[second]) * (1.0 - second_part),
            vector,
            joint,
        )

    def later(self, sums: Sums, vector: _Array, detect: float) -> int | None:
        """Block since which something differs from this vector (unknowns,) of changes; None if nothing does."""
        left = sums.b - np.einsum("nij,j->ni", sums.a, vector)
        ratios = self._ratios(np.einsum("nii->ni", sums.a), left)[1][:-1].max(axis=1, initial=0.0)
        if not len(ratios):
            return None
        block = int(np.argmax(ratios))
        return block if float(ratios[block]) > detect else None

    def rejects(self, sums: Sums, vector: _Array, strength: float) -> bool:
        """Whether the window speaks against this vector of changes, and for none."""
        a, b = sums.a[0], sums.b[0]
        return float(vector @ b - 0.5 * vector @ a @ vector) / float(self.spread.max()) ** 2 < -strength
