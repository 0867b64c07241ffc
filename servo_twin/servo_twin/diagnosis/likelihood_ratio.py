"""Log likelihood ratios of every single change, since every block, against no change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servo_twin.diagnosis.window import Sums

_TRANSIENT: Final = 3  # blocks after a change in which the loops settle; excluded once enough blocks follow

_Array = NDArray[np.float64]

_ANGLE: Final = "encoder_angle"  # evaluated together with the apparent change of flux in the q axis


def _apparent_flux_change(sine: float | _Array) -> _Array:
    """Apparent relative change of flux in the q axis at an angle error of the encoder with this sine."""
    return np.asarray(np.sqrt(np.maximum(1.0 - np.square(sine), 0.0)) - 1.0)


def _transient_fraction(a: _Array, b: _Array, blocks: int) -> float:
    """Fraction of the log likelihood ratio of one change that the strongest blocks contribute, from 0 to 1.

    Parameters
    ----------
    a, b : ndarray, shape (blocks,)
        Information and right side of the change since the start of each block; the first entries cover all blocks.
    blocks : int
        Number of strongest blocks.
    """
    value = b[0] / a[0]
    since = value * b - 0.5 * value**2 * a
    alone = since - np.append(since[1:], 0.0)
    return float(min(np.sort(alone)[-blocks:].sum() / since[0], 1.0)) if since[0] > 0.0 else 1.0


@dataclass(frozen=True)
class DetectionStatistics:
    """Statistics of the most likely change in a window."""

    start_block: int  # first block of the change
    evaluation_block: int  # first block of the evaluation, after the transient
    change: int  # index into `Unknowns.names` of the most likely single change
    value: float  # estimate of the change
    deviation: float  # standard deviation of the estimate
    log_likelihood_ratio: float  # of the change against no change
    robust_log_likelihood_ratio: float  # the same without the strongest blocks, see `Unknowns.transient_blocks`
    runner_up: int  # second most likely single change
    runner_up_ratio: float  # log likelihood ratio of `runner_up` against no change, since `evaluation_block`
    second: int  # most likely additional change, together with `change`
    second_ratio: float  # log likelihood ratio of `second` against `change` alone, without the strongest blocks
    vector: _Array  # (unknowns,), unknowns with the single change
    joint: _Array  # (unknowns,), unknowns with `change` and `second`


@dataclass(frozen=True)
class Unknowns:
    """Quantities of one set of equations that may change."""

    names: tuple[str, ...]
    margins: _Array  # (unknowns,), model uncertainty; an estimate within it is ignored
    spread: _Array  # (unknowns,), standard deviation of an estimate relative to white noise
    transient_blocks: Sequence[int]  # (unknowns,), number of strongest blocks that the decision excludes

    def vector(self, change: int, value: float) -> _Array:
        """Unknowns (unknowns,) with a single change; a slipped encoder also reduces the apparent flux in the q axis."""
        vector = np.zeros(len(self.names))
        vector[change] = value
        if self.names[change] == _ANGLE:
            vector[self.names.index("flux")] = _apparent_flux_change(value)
        return vector

    def _singles(self, sums: Sums) -> tuple[_Array, _Array]:
        """As `_ratios`, since every block, with the apparent change of flux by an encoder angle."""
        values, ratios = self._ratios(np.einsum("nii->ni", sums.a), sums.b)
        if _ANGLE in self.names:
            angle, flux = self.names.index(_ANGLE), self.names.index("flux")
            flux_change = _apparent_flux_change(values[:, angle])
            residual = (
                sums.b[:, flux] - sums.a[:, angle, flux] * values[:, angle] - 0.5 * sums.a[:, flux, flux] * flux_change
            )
            ratios[:, angle] += np.where(ratios[:, angle] > 0.0, flux_change * residual, 0.0) / self.spread[flux] ** 2
        return values, ratios

    def _ratios(self, a: _Array, b: _Array) -> tuple[_Array, _Array]:
        """Estimates of single changes, and their log likelihood ratios.

        Parameters
        ----------
        a, b : ndarray, shape (..., unknowns)
            Diagonal of the information matrix, and right sides.
        """
        excited = a > 0.0
        value = np.where(excited, b / np.where(excited, a, 1.0), 0.0)
        excess = np.maximum(np.abs(value) - self.margins, 0.0)
        return value, 0.5 * excess**2 * a / self.spread**2

    def strongest(self, sums: Sums) -> float:
        """Largest log likelihood ratio of any change since any block."""
        return float(self._singles(sums)[1][:-1].max())

    def statistics(self, sums: Sums) -> DetectionStatistics:
        """Statistics of the most likely single change and of its start block."""
        values, ratios = self._singles(sums)
        ratios = ratios[: max(len(ratios) - 1, 1)]  # the last block alone is not sufficient
        block, change = (int(k) for k in np.unravel_index(int(np.argmax(ratios)), ratios.shape))
        since = block
        if len(sums.samples) - block > 2 * _TRANSIENT:
            block += _TRANSIENT
            change = int(np.argmax(ratios[block]))
        a, b = sums.a[block], sums.b[block]
        if not a[change, change] > 0.0:
            none = np.zeros(len(self.names))
            return DetectionStatistics(
                start_block=since,
                evaluation_block=block,
                change=change,
                value=0.0,
                deviation=float("inf"),
                log_likelihood_ratio=0.0,
                robust_log_likelihood_ratio=0.0,
                runner_up=change,
                runner_up_ratio=0.0,
                second=change,
                second_ratio=0.0,
                vector=none,
                joint=none,
            )
        value, ratio = float(values[block, change]), float(ratios[block, change])
        vector = self.vector(change, value)
        residual = b - a @ vector
        diagonal = np.diag(a)
        reduced = diagonal - a[change] ** 2 / a[change, change]
        reduced = np.where(reduced > 1e-6 * diagonal, reduced, 0.0)
        reduced[change] = 0.0
        seconds, second_ratios = self._ratios(reduced, residual)
        second = int(np.argmax(second_ratios))
        second_right_side = sums.b[block:, second] - sums.a[block:, second] @ vector
        second_part = (
            _transient_fraction(sums.a[block:, second, second], second_right_side, self.transient_blocks[second])
            if second_ratios[second] > 0.0
            else 0.0
        )
        others = np.where(np.arange(len(self.names)) == change, -1.0, ratios[block])
        runner_up = int(np.argmax(others))
        joint = vector.copy()
        joint[second] += seconds[second]
        joint[change] -= seconds[second] * a[change, second] / a[change, change]
        transient = _transient_fraction(
            sums.a[block:, change, change], sums.b[block:, change], self.transient_blocks[change]
        )
        return DetectionStatistics(
            start_block=since,
            evaluation_block=block,
            change=change,
            value=value,
            deviation=float(self.spread[change] / np.sqrt(a[change, change])),
            log_likelihood_ratio=ratio,
            robust_log_likelihood_ratio=ratio * (1.0 - transient),
            runner_up=runner_up,
            runner_up_ratio=float(max(others[runner_up], 0.0)),
            second=second,
            second_ratio=float(second_ratios[second]) * (1.0 - second_part),
            vector=vector,
            joint=joint,
        )

    def onset(self, sums: Sums, vector: _Array, detect: float) -> int | None:
        """First block of a deviation from this vector of changes, shape (unknowns,); None if there is none."""
        residual = sums.b - np.einsum("nij,j->ni", sums.a, vector)
        ratios = self._ratios(np.einsum("nii->ni", sums.a), residual)[1][:-1].max(axis=1, initial=0.0)
        if not len(ratios):
            return None
        block = int(np.argmax(ratios))
        return block if float(ratios[block]) > detect else None

    def contradicts(self, sums: Sums, vector: _Array, strength: float) -> bool:
        """True if the window contradicts this vector of changes in favour of no change."""
        a, b = sums.a[0], sums.b[0]
        return float(vector @ b - 0.5 * vector @ a @ vector) / float(self.spread.max()) ** 2 < -strength
