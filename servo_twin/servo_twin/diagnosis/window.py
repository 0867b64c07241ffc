"""Sums of weighted equations in blocks of motion, and what they say of a change since any of these blocks. Pure."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["BLOCK", "Window"]

BLOCK: Final = 0.1
"""Time in motion that a block holds [s]."""

_BLOCKS: Final = 120

_Array = NDArray[np.float64]


class Sums(NamedTuple):
    """Normal equations of the samples since the beginning of each block.

    Attributes
    ----------
    a : ndarray, shape (blocks, unknowns, unknowns)
        Information.
    b : ndarray, shape (blocks, unknowns)
    energy : ndarray, shape (blocks,)
        Weighted squares of the left sides.
    samples : ndarray, shape (blocks,)
        Independent samples.
    """

    a: _Array
    b: _Array
    energy: _Array
    samples: _Array


class Window:
    """The last blocks of one set of equations; nothing is forgotten while nothing moves.

    Parameters
    ----------
    size : int
        Unknowns.

    Attributes
    ----------
    ticks : list of int
        When each block began.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self.ticks: list[int] = []
        self._sums: list[tuple[_Array, _Array, float, float]] = []
        self._begin()

    def _begin(self) -> None:
        self._a = np.zeros((self._size, self._size))
        self._b = np.zeros(self._size)
        self._energy = self._count = self._time = 0.0
        self._tick: int | None = None

    def clear(self) -> None:
        """Forget everything."""
        self.ticks.clear()
        self._sums.clear()
        self._begin()

    def forget_before(self, block: int) -> None:
        """Forget the blocks before this one."""
        del self.ticks[:block], self._sums[:block]

    def add(self, tick: int, seconds: float, y: _Array, phi: _Array, weight: _Array) -> bool:
        """Add the equations of a sample; returns whether a block has become full.

        Parameters
        ----------
        tick : int
            Of the sample.
        seconds : float
            Time in motion that it stands for [s].
        y, weight : ndarray, shape (equations,)
            Left sides; independent samples per variance.
        phi : ndarray, shape (equations, unknowns)
        """
        if self._tick is None:
            self._tick = tick
        weighted = phi * weight[:, None]
        self._a += weighted.T @ phi
        self._b += weighted.T @ y
        self._energy += float(y @ (weight * y))
        self._count += len(y)
        self._time += seconds
        if self._time < BLOCK:
            return False
        self.ticks.append(self._tick)
        self._sums.append((self._a, self._b, self._energy, self._count))
        if len(self.ticks) > _BLOCKS:
            self.forget_before(1)
        self._begin()
        return True

    def sums(self) -> Sums:
        """From the beginning of each block to now."""
        a, b, energy, count = (np.array(part) for part in zip(*self._sums, strict=True))
        return Sums(*(np.cumsum(part[::-1], axis=0)[::-1] for part in (a, b, energy, count)))
