"""Sums of weighted equations in blocks of motion, and what they say of a change since any of these blocks. Pure."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["BLOCK", "Rows", "Sums", "Window"]

BLOCK: Final = 0.1
"""Time in motion that a block holds [s]."""

_BLOCKS: Final = 120

_Array = NDArray[np.float64]


class Rows(NamedTuple):
    """Equations of one sample.

    Attributes
    ----------
    y : ndarray, shape (equations,)
        Left sides.
    phi : ndarray, shape (equations, unknowns + nuisances)
        Right sides.
    weight : ndarray, shape (equations,)
        Independent samples per variance.
    samples : ndarray, shape (equations,)
        Independent samples.
    """

    y: _Array
    phi: _Array
    weight: _Array
    samples: _Array


class Sums(NamedTuple):
    """Normal equations of the samples since the beginning of each block.

    Attributes
    ----------
    a : ndarray, shape (blocks, unknowns, unknowns)
        Information, that of the nuisances eliminated.
    b : ndarray, shape (blocks, unknowns)
    parts_a : ndarray, shape (blocks, equations, unknowns + nuisances, unknowns + nuisances)
    parts_b : ndarray, shape (blocks, equations, unknowns + nuisances)
        The same per equation, before the elimination.
    energy : ndarray, shape (blocks, equations)
        Weighted squares of the left sides.
    samples : ndarray, shape (blocks, equations)
        Independent samples.
    """

    a: _Array
    b: _Array
    parts_a: _Array
    parts_b: _Array
    energy: _Array
    samples: _Array


class Window:
    """The last blocks of some equations; nothing is forgotten while nothing moves.

    Parameters
    ----------
    size : int
        Unknowns.
    equations : int
    prior : ndarray, shape (nuisances,)
        What is known of the nuisances besides, unknowns of no interest: one over their variance.

    Attributes
    ----------
    ticks : list of int
        When each block began.
    """

    def __init__(self, size: int, equations: int, prior: _Array) -> None:
        self._size, self._equations, self._prior = size, equations, np.diag(prior)
        self.ticks: list[int] = []
        self._sums: list[tuple[_Array, _Array, _Array, _Array]] = []
        self._begin()

    def _begin(self) -> None:
        wide = self._size + len(self._prior)
        self._a = np.zeros((self._equations, wide, wide))
        self._b = np.zeros((self._equations, wide))
        self._energy, self._samples = np.zeros(self._equations), np.zeros(self._equations)
        self._time = 0.0
        self._tick: int | None = None

    def clear(self) -> None:
        """Forget everything."""
        self.ticks.clear()
        self._sums.clear()
        self._begin()

    def forget_before(self, block: int) -> None:
        """Forget the blocks before this one."""
        del self.ticks[:block], self._sums[:block]

    def add(self, tick: int, seconds: float, rows: Rows) -> bool:
        """Add the equations of a sample; returns whether a block has become full.

        Parameters
        ----------
        tick : int
            Of the sample.
        seconds : float
            Time in motion that it stands for [s].
        rows : Rows
        """
        if self._tick is None:
            self._tick = tick
        weighted = rows.phi * rows.weight[:, None]
        self._a += weighted[:, :, None] * rows.phi[:, None, :]
        self._b += weighted * rows.y[:, None]
        self._energy += rows.weight * rows.y**2
        self._samples += rows.samples
        self._time += seconds
        if self._time < BLOCK:
            return False
        self.ticks.append(self._tick)
        self._sums.append((self._a, self._b, self._energy, self._samples))
        if len(self.ticks) > _BLOCKS:
            self.forget_before(1)
        self._begin()
        return True

    def sums(self) -> Sums:
        """From the beginning of each block to now."""
        parts = (np.array(part) for part in zip(*self._sums, strict=True))
        parts_a, parts_b, energy, samples = (np.cumsum(part[::-1], axis=0)[::-1] for part in parts)
        a, b, size = parts_a.sum(axis=1), parts_b.sum(axis=1), self._size
        if len(self._prior):
            cross = a[:, :size, size:] @ np.linalg.inv(a[:, size:, size:] + self._prior)
            b = b[:, :size] - np.einsum("nij,nj->ni", cross, b[:, size:])
            a = a[:, :size, :size] - cross @ a[:, size:, :size]
        return Sums(a, b, parts_a, parts_b, energy, samples)

    def left(self, sums: Sums, block: int, vector: _Array) -> _Array:
        """Weighted squares (equations,) that these unknowns leave since a block, with the best nuisance terms."""
        a, b, size = sums.parts_a[block], sums.parts_b[block], self._size
        whole = a.sum(axis=0)
        rest = b.sum(axis=0)[size:] - whole[size:, :size] @ vector
        nuisances = np.linalg.solve(whole[size:, size:] + self._prior, rest)
        wide = np.concatenate([vector, nuisances])
        return np.asarray(sums.energy[block] - 2.0 * b @ wide + np.einsum("i,eij,j->e", wide, a, wide))
