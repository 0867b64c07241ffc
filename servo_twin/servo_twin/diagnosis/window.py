"""Normal equations of a sliding window, in blocks of motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

BLOCK: Final = 0.1
"""Time in motion per block [s]."""

_BLOCKS: Final = 120  # blocks of the window
_CAPACITY: Final = 2 * _BLOCKS

_Array = NDArray[np.float64]
_Sample = TypeVar("_Sample")


class Rows(NamedTuple):
    """Equations of several samples."""

    y: _Array  # (rows, equations), left-hand sides
    phi: _Array  # (rows, equations, unknowns + nuisances), regressors
    weight: _Array  # (rows, equations), independent samples per variance
    samples: _Array  # (rows, equations), independent samples


class _Block(NamedTuple):
    """Normal equations of the samples of one block, per equation; shapes as in `Sums`, without blocks."""

    a: _Array  # (..., equations, unknowns + nuisances, unknowns + nuisances), information
    b: _Array  # (..., equations, unknowns + nuisances), right sides
    energy: _Array  # (..., equations), weighted squares of the left sides
    samples: _Array  # (..., equations), independent samples

    @classmethod
    def of(cls, rows: Rows) -> _Block:
        y, phi, weight, samples = rows
        weighted = phi * weight[:, :, None]
        a = weighted.transpose(1, 2, 0) @ phi.transpose(1, 0, 2)
        return cls(a, np.einsum("nei,ne->ei", weighted, y), np.einsum("ne,ne->e", weight, y**2), samples.sum(axis=0))


class Sums(NamedTuple):
    """Normal equations of a window."""

    a: _Array  # (blocks, unknowns, unknowns), information since the start of each block, nuisances eliminated
    b: _Array  # (blocks, unknowns), right sides of `a`
    parts_a: _Array
    """(blocks, equations, unknowns + nuisances, unknowns + nuisances), information of each single block, per equation,
    before the elimination."""
    parts_b: _Array  # (blocks, equations, unknowns + nuisances), right sides of `parts_a`
    energy: _Array  # (blocks, equations), weighted squares of `Rows.y` since the start of each block
    samples: _Array  # (blocks, equations), independent samples since the start of each block


class Window(Generic[_Sample]):
    """The last `_BLOCKS` blocks of motion; standstill discards none.

    Parameters
    ----------
    size : int
        Number of unknowns.
    prior : ndarray, shape (nuisances,)
        Inverse prior variances of the nuisance unknowns.
    rows : callable
        Converts the samples of a block to equations.
    """

    def __init__(self, size: int, prior: _Array, rows: Callable[[Sequence[_Sample]], Rows]) -> None:
        self._size, self._prior, self._rows = size, np.diag(prior), rows
        self.ticks: list[int] = []  # start of each block [tick]
        self._blocks: _Block | None = None  # stacked, `_CAPACITY` entries; the present blocks start at `_first`
        self._first = 0
        self._begin()

    def _begin(self) -> None:
        self._pending: list[_Sample] = []
        self._time = 0.0
        self._tick: int | None = None

    def clear(self) -> None:
        """Discard all data."""
        self.ticks.clear()
        self._begin()

    def discard_before(self, block: int) -> None:
        """Discard the blocks before this one."""
        del self.ticks[:block]
        self._first += block

    def add(self, tick: int, seconds: float, sample: _Sample) -> bool:
        """Add a sample; True if this completes a block.

        Parameters
        ----------
        tick : int
            Tick of the sample.
        seconds : float
            Time in motion that the sample represents [s].
        sample
            Input of `rows`.
        """
        if self._tick is None:
            self._tick = tick
        self._pending.append(sample)
        self._time += seconds
        if self._time < BLOCK:
            return False
        if len(self.ticks) == _BLOCKS:
            self.discard_before(1)
        self._append(_Block.of(self._rows(self._pending)))
        self.ticks.append(self._tick)
        self._begin()
        return True

    def _append(self, block: _Block) -> None:
        if self._blocks is None:
            self._blocks = _Block(*(np.zeros((_CAPACITY, *part.shape)) for part in block))
        present, index = self._present, self._first + len(self.ticks)
        if index == _CAPACITY:
            for stack in self._blocks:
                stack[: len(self.ticks)] = stack[present]
            self._first, index = 0, len(self.ticks)
        for stack, part in zip(self._blocks, block, strict=True):
            stack[index] = part

    @property
    def _present(self) -> slice:
        return slice(self._first, self._first + len(self.ticks))

    def sums(self) -> Sums:
        """Sums since the start of each block; requires at least one block. Valid until the next call of `add`."""
        assert self._blocks is not None
        parts_a, parts_b, energy, samples = (stack[self._present] for stack in self._blocks)
        since = (parts_a.sum(axis=1), parts_b.sum(axis=1), energy, samples)
        a, b, energy, samples = (np.cumsum(part[::-1], axis=0)[::-1] for part in since)
        size = self._size
        if len(self._prior):
            cross = a[:, :size, size:] @ np.linalg.inv(a[:, size:, size:] + self._prior)
            b = b[:, :size] - np.einsum("nij,nj->ni", cross, b[:, size:])
            a = a[:, :size, :size] - cross @ a[:, size:, :size]
        return Sums(a, b, parts_a, parts_b, energy, samples)

    def residual_energy(self, sums: Sums, block: int, vector: _Array) -> _Array:
        """Weighted squares of the residual per equation since a block, for these unknowns and the best nuisances."""
        a, b, size = sums.parts_a[block:].sum(axis=0), sums.parts_b[block:].sum(axis=0), self._size
        whole = a.sum(axis=0)
        nuisance_b = b.sum(axis=0)[size:] - whole[size:, :size] @ vector
        nuisances = np.linalg.solve(whole[size:, size:] + self._prior, nuisance_b)
        extended = np.concatenate([vector, nuisances])
        return np.asarray(sums.energy[block] - 2.0 * b @ extended + np.einsum("i,eij,j->e", extended, a, extended))
