"""Varied values and points of the trials. A point depends on seed and trial number only."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final, Literal

import numpy as np
from servo_msgs_py.value_text import parse_assignment

Method = Literal["grid", "latin", "random"]
METHODS: Final[tuple[Method, ...]] = ("grid", "latin", "random")

SYNTAX: Final = """\
NAME=VALUES, where VALUES is one of
  0.5,1,2         these values
  0.5..2          uniform distribution
  0.5..2 log      uniform on a logarithmic scale
  0.5..2/5        five equidistant values ("0.5..2/5 log")
  1+-0.1          normal distribution: mean and standard deviation
A leading * makes them factors of the nominal value."""

_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE: Final = re.compile(rf"({_NUMBER})\.\.({_NUMBER})(?:/(\d+))?( log)?")
_NORMAL: Final = re.compile(rf"({_NUMBER})\+-({_NUMBER})")


class SpaceError(ValueError):
    """Invalid specification of varied values; the message contains the reason."""


@dataclass(frozen=True)
class Varied:
    """One varied value."""

    name: str  # see `servo_twin.validation.sweep.variant`
    levels: tuple[float, ...] = ()  # discrete values; empty: a distribution
    low: float = 0.0  # lower end of the range; the mean if `kind` is ``normal``
    high: float = 0.0  # upper end of the range; the standard deviation if `kind` is ``normal``
    kind: Literal["even", "log", "normal"] = "even"  # distribution
    factor: bool = False  # the values are factors of the nominal value

    @classmethod
    def parse(cls, text: str) -> Varied:
        """Read ``NAME=VALUES`` (`SYNTAX`).

        Raises
        ------
        SpaceError
            If the text is invalid.
        """
        try:
            name, values = parse_assignment(text, "NAME=VALUES")
        except ValueError as error:
            raise SpaceError(str(error)) from None
        factor, values = values.startswith("*"), values.removeprefix("*").strip()
        if found := _NORMAL.fullmatch(values):
            mean, deviation = map(float, found.groups())
            if deviation <= 0.0:
                raise SpaceError(f"{text!r}: the standard deviation is not above 0")
            return cls(name, (), mean, deviation, "normal", factor)
        if found := _RANGE.fullmatch(values):
            return cls._of_range(text, name, found, factor)
        try:
            levels = tuple(float(value) for value in values.split(","))
        except ValueError:
            raise SpaceError(f"{text!r}: {values!r} is not valid for VALUES\n{SYNTAX}") from None
        if not all(map(math.isfinite, levels)):
            raise SpaceError(f"{text!r}: a value is not finite")
        return cls(name, levels, factor=factor)

    @classmethod
    def _of_range(cls, text: str, name: str, found: re.Match[str], factor: bool) -> Varied:
        low, high = float(found[1]), float(found[2])
        if low >= high:
            raise SpaceError(f"{text!r}: the lower end is not below the upper end")
        if found[4] and low <= 0.0:
            raise SpaceError(f"{text!r}: a logarithmic scale requires values above 0")
        kind: Literal["even", "log"] = "log" if found[4] else "even"
        if found[3] is None:
            return cls(name, (), low, high, kind, factor)
        if int(found[3]) < 2:
            raise SpaceError(f"{text!r}: at least two values are required")
        spaced = np.geomspace if found[4] else np.linspace
        return cls(name, tuple(map(float, spaced(low, high, int(found[3])))), factor=factor)

    def times(self, nominal: float) -> Varied:
        """Convert factors to values with `nominal`."""
        low, high = self.low * nominal, self.high * abs(nominal) if self.kind == "normal" else self.high * nominal
        if self.kind != "normal" and low > high:
            low, high = high, low
        if self.kind == "log" and low <= 0.0:
            raise SpaceError(f"{self.name}: a logarithmic scale requires values above 0; nominal: {nominal:g}")
        return Varied(self.name, tuple(level * nominal for level in self.levels), low, high, self.kind)

    def quantile(self, part: float) -> float:
        """Quantile of the distribution for a fraction 0 .. 1."""
        if self.levels:
            return self.levels[min(int(part * len(self.levels)), len(self.levels) - 1)]
        if self.kind == "normal":
            return NormalDist(self.low, self.high).inv_cdf(min(max(part, 1e-9), 1.0 - 1e-9))
        if self.kind == "log":
            return self.low * math.pow(self.high / self.low, part)
        return self.low + part * (self.high - self.low)


def shuffled(index: int, count: int, key: str) -> int:
    """Random permutation of ``range(count)``: image of `index`, without storing the permutation.

    Feistel network over the next even number of bits; results beyond `count` are permuted again.
    """
    half = max((count - 1).bit_length() + 1, 2) // 2
    mask = (1 << half) - 1
    while True:
        left, right = index >> half, index & mask
        for round_number in range(4):
            digest = hashlib.blake2b(f"{key} {round_number} {right}".encode(), digest_size=8).digest()
            left, right = right, left ^ (int.from_bytes(digest, "little") & mask)
        index = left << half | right
        if index < count:
            return index


@dataclass(frozen=True)
class Space:
    """Points of all trials."""

    varied: tuple[Varied, ...]  # varied values
    method: Method  # all combinations, Latin hypercube, or independent random points
    count: int  # number of points
    seed: int  # of random points

    @classmethod
    def of(cls, varied: Sequence[Varied], method: Method | None, count: int | None, seed: int) -> Space:
        """Create the space; default method: grid if all values are discrete, else Latin hypercube.

        Raises
        ------
        SpaceError
            If method and values are not compatible.
        """
        names = [one.name for one in varied]
        if not names:
            raise SpaceError("no varied values")
        if twice := {name for name in names if names.count(name) > 1}:
            raise SpaceError(f"varied twice: {', '.join(sorted(twice))}")
        even = [one.name for one in varied if not one.levels]
        chosen = method or ("latin" if even or count is not None else "grid")
        if chosen == "grid":
            if even:
                raise SpaceError(f"a grid requires discrete values: write {even[0]}=LOW..HIGH/STEPS")
            if count is not None:
                raise SpaceError("the number of combinations determines the points of a grid: omit the count")
            return cls(tuple(varied), chosen, math.prod(len(one.levels) for one in varied), seed)
        if count is None:
            raise SpaceError(f"the method {chosen} requires --count")
        return cls(tuple(varied), chosen, count, seed)

    def point(self, number: int) -> dict[str, float]:
        """Varied values of trial `number`, by name, in the units of their files."""
        if self.method == "grid":
            return self._of_grid(number)
        parts = np.random.Generator(np.random.PCG64([self.seed, number])).random(len(self.varied))
        if self.method == "latin":
            cells = [shuffled(number, self.count, f"{self.seed} {one.name}") for one in self.varied]
            parts = (np.array(cells) + parts) / self.count
        return {one.name: one.quantile(float(part)) for one, part in zip(self.varied, parts, strict=True)}

    def _of_grid(self, number: int) -> dict[str, float]:
        point: dict[str, float] = {}
        for one in reversed(self.varied):
            number, level = divmod(number, len(one.levels))
            point[one.name] = one.levels[level]
        return {one.name: point[one.name] for one in self.varied}
