"""What is varied, and the point of every trial. Pure; a point follows from seed and number alone."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final, Literal

import numpy as np

Method = Literal["grid", "latin", "random"]
METHODS: Final[tuple[Method, ...]] = ("grid", "latin", "random")

SYNTAX: Final = """\
NAME=VALUES, where VALUES is one of
  0.5,1,2         these
  0.5..2          from .. to, even
  0.5..2 log      even on a logarithmic scale
  0.5..2/5        five values from the first to the last ("0.5..2/5 log")
  1+-0.1          normally distributed: mean and standard deviation
and * in front of them makes them factors of the nominal value."""

_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE: Final = re.compile(rf"({_NUMBER})\.\.({_NUMBER})(?:/(\d+))?( log)?")
_NORMAL: Final = re.compile(rf"({_NUMBER})\+-({_NUMBER})")


class SpaceError(ValueError):
    """Something cannot be varied as it was asked for; the message says what is wrong."""


@dataclass(frozen=True)
class Varied:
    """One value that is varied."""

    name: str  # as in `servo_twin.sweep.variant`
    levels: tuple[float, ...] = ()  # the values of a discrete one
    low: float = 0.0  # lower end of its range otherwise; the mean if `kind` is ``normal``
    high: float = 0.0  # upper end of its range; the standard deviation if `kind` is ``normal``
    kind: Literal["even", "log", "normal"] = "even"  # its distribution
    factor: bool = False  # whether the values are factors of the nominal one

    @classmethod
    def parse(cls, text: str) -> Varied:
        """Read ``NAME=VALUES`` (`SYNTAX`).

        Raises
        ------
        SpaceError
            If it is something else.
        """
        name, equals, values = (part.strip() for part in text.partition("="))
        if not (name and equals and values):
            raise SpaceError(f"{text!r} is not NAME=VALUES")
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
            raise SpaceError(f"{text!r}: {values!r} are no values\n{SYNTAX}") from None
        if not all(map(math.isfinite, levels)):
            raise SpaceError(f"{text!r}: a value is not finite")
        return cls(name, levels, factor=factor)

    @classmethod
    def _of_range(cls, text: str, name: str, found: re.Match[str], factor: bool) -> Varied:
        low, high = float(found[1]), float(found[2])
        if low >= high:
            raise SpaceError(f"{text!r}: the range does not go upwards")
        if found[4] and low <= 0.0:
            raise SpaceError(f"{text!r}: a logarithmic scale begins above 0")
        kind: Literal["even", "log"] = "log" if found[4] else "even"
        if found[3] is None:
            return cls(name, (), low, high, kind, factor)
        if int(found[3]) < 2:
            raise SpaceError(f"{text!r}: a range has at least two values")
        spaced = np.geomspace if found[4] else np.linspace
        return cls(name, tuple(map(float, spaced(low, high, int(found[3])))), factor=factor)

    def times(self, nominal: float) -> Varied:
        """Values instead of factors of `nominal`."""
        low, high = self.low * nominal, self.high * abs(nominal) if self.kind == "normal" else self.high * nominal
        if self.kind != "normal" and low > high:
            low, high = high, low
        if self.kind == "log" and low <= 0.0:
            raise SpaceError(f"{self.name}: a logarithmic scale begins above 0, and the nominal value is {nominal:g}")
        return Varied(self.name, tuple(level * nominal for level in self.levels), low, high, self.kind)

    def at(self, part: float) -> float:
        """Value below which a part (0 .. 1) of all values lies."""
        if self.levels:
            return self.levels[min(int(part * len(self.levels)), len(self.levels) - 1)]
        if self.kind == "normal":
            return NormalDist(self.low, self.high).inv_cdf(min(max(part, 1e-9), 1.0 - 1e-9))
        if self.kind == "log":
            return self.low * math.pow(self.high / self.low, part)
        return self.low + part * (self.high - self.low)


def shuffled(index: int, count: int, key: str) -> int:
    """Place of `index` in a random order of ``range(count)``, without a list of it.

    A Feistel network over the next even number of bits; what falls outside goes through it again.
    """
    half = max((count - 1).bit_length() + 1, 2) // 2
    mask = (1 << half) - 1
    while True:
        left, right = index >> half, index & mask
        for turn in range(4):
            digest = hashlib.blake2b(f"{key} {turn} {right}".encode(), digest_size=8).digest()
            left, right = right, left ^ (int.from_bytes(digest, "little") & mask)
        index = left << half | right
        if index < count:
            return index


@dataclass(frozen=True)
class Space:
    """The points of all trials."""

    varied: tuple[Varied, ...]  # what is varied
    method: Method  # every combination; a Latin hypercube, which spreads each value evenly; or each point by itself
    count: int  # number of points
    seed: int  # of random points

    @classmethod
    def of(cls, varied: Sequence[Varied], method: Method | None, count: int | None, seed: int) -> Space:
        """The space as requested; by default a grid where every value has levels, else a Latin hypercube.

        Raises
        ------
        SpaceError
            If method and values do not go together.
        """
        names = [one.name for one in varied]
        if not names:
            raise SpaceError("nothing is varied")
        if twice := {name for name in names if names.count(name) > 1}:
            raise SpaceError(f"varied twice: {', '.join(sorted(twice))}")
        even = [one.name for one in varied if not one.levels]
        chosen = method or ("latin" if even or count is not None else "grid")
        if chosen == "grid":
            if even:
                raise SpaceError(f"a grid needs single values: write {even[0]}=LOW..HIGH/STEPS")
            if count is not None:
                raise SpaceError("a grid has as many points as combinations: leave the count out")
            return cls(tuple(varied), chosen, math.prod(len(one.levels) for one in varied), seed)
        if count is None:
            raise SpaceError("how many points? Give their count")
        return cls(tuple(varied), chosen, count, seed)

    def point(self, number: int) -> dict[str, float]:
        """Value, in its own unit, of everything that is varied, by name, in trial `number`."""
        if self.method == "grid":
            return self._of_grid(number)
        parts = np.random.Generator(np.random.PCG64([self.seed, number])).random(len(self.varied))
        if self.method == "latin":
            cells = [shuffled(number, self.count, f"{self.seed} {one.name}") for one in self.varied]
            parts = (np.array(cells) + parts) / self.count
        return {one.name: one.at(float(part)) for one, part in zip(self.varied, parts, strict=True)}

    def _of_grid(self, number: int) -> dict[str, float]:
        point: dict[str, float] = {}
        for one in reversed(self.varied):
            number, place = divmod(number, len(one.levels))
            point[one.name] = one.levels[place]
        return {one.name: point[one.name] for one in self.varied}
