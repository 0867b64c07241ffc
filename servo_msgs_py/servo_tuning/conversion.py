"""Conversion of SI units to the integers of ``axis_config_t``; refusals name the entry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from servo_tuning.configuration import Axis, Board, Scales
from servo_tuning.errors import Entry, Remedy, higher, lower
from servo_tuning.formats import member_format
from servo_tuning.gains import Pi


class PiRaw(NamedTuple):
    """A ``pi_gains_t``."""

    kp: int
    ki: int
    kc: int


class FaultSet(tuple[str, ...]):
    """Names of faults in the contract, lower case."""


class Category(str):
    """A stop category."""


class Switches(tuple[str, ...]):
    """Names of the features that are on, as in the contract."""


Field = int | tuple[int, ...] | PiRaw | Switches | FaultSet | Category
AxisConstants = Mapping[str, Field]
"""C path of every field of ``axis_config_t`` with its value."""


@dataclass(frozen=True)
class Fraction:
    """Value of a member before it is rounded to an integer."""

    entry: Entry | str  # the entry, or the name of the quantity computed from several entries; for the refusal
    value: float  # as a fraction of full scale, or in raw units
    remedies: tuple[Remedy | str, ...] = ()  # for the refusal; of an entry: to lower it, and to raise it
    given: float | None = None  # of an entry that `value` is proportional to: its value in the configuration

    def raw(self, path: str) -> int:
        """Integer of the member `path`.

        Raises
        ------
        ConfigError
            If the member cannot have this value.
        """
        format_ = member_format(path)
        remedies = self.remedies
        if self.given is not None:
            remedies = remedies[:1] if abs(self.value) > format_.maximum else remedies[1:]
        return format_.raw(self.entry, self.value, *remedies, given=self.given)


Value = Field | Fraction


def rounded(values: Mapping[str, Value]) -> dict[str, Field]:
    """Integers of fields by path.

    Raises
    ------
    ConfigError
        If a member cannot have its value.
    """
    return {path: value.raw(path) if isinstance(value, Fraction) else value for path, value in values.items()}


@dataclass(frozen=True)
class Converter:
    """Conversion of the values of one axis."""

    axis: Axis
    board: Board
    s: Scales

    def at(self, path: str, scale: float) -> Fraction:
        """Entry of the axis times `scale`."""
        value, changes = self.axis(path), (self.axis.named(lower(path)), self.axis.named(higher(path)))
        return Fraction(self.axis.entry(path), value * scale, changes, value)

    def board_at(self, key: str, scale: float) -> Fraction:
        """Entry of [board] times `scale`."""
        entry, value = f"board.{key}", self.board(key)
        return Fraction(entry, value * scale, (lower(entry), higher(entry)), value)

    def ticks(self, path: str) -> Fraction:
        """Time, in slow ticks."""
        return self.at(path, 1.0 / self.board.tick)

    def of(self, name: str, value: float, *remedies: Remedy | str) -> Fraction:
        """Value that depends on several entries, as a fraction of full scale."""
        return Fraction(f"{self.axis.name}: {name}", value, tuple(map(self.axis.named, remedies)))

    def pi(self, path: str, name: str, gains: Pi, scale: float, *remedies: Remedy | str) -> PiRaw:
        """Raw gains of the PI controller `path`; `scale` converts SI gains to full scale per full scale."""
        return PiRaw(
            self.of(f"{name} Kp", gains.kp * scale, *remedies).raw(f"{path}.kp"),
            self.of(f"{name} Kp Ki Ts", gains.ki * scale, *remedies).raw(f"{path}.ki"),
            self.of(f"{name} Kc", gains.kc, higher("control.anti_windup")).raw(f"{path}.kc"),
        )
