"""Conversion of SI units to the integers of ``axis_config_t``; refusals name the entry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from servo_tuning.configuration import Axis, Board, Scales
from servo_tuning.errors import Remedy, higher, lower
from servo_tuning.formats import GAIN, FixedPoint, fixed_point
from servo_tuning.gains import Pi

TICKS: Final = fixed_point("uint16_t slow ticks", 0, 0, 2**16 - 2)
"""The 16-bit counter must be able to count beyond the largest value."""


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


def pi_raw(axis: Axis, name: str, gains: Pi, scale: float, *remedies: Remedy | str) -> PiRaw:
    """Raw gains of a PI controller; `scale` converts SI gains to full scale per full scale."""
    entry, changes = f"{axis.name}: {name}", [axis.named(remedy) for remedy in remedies]
    return PiRaw(
        GAIN.raw(f"{entry} Kp", gains.kp * scale, *changes),
        GAIN.raw(f"{entry} Kp Ki Ts", gains.ki * scale, *changes),
        GAIN.raw(f"{entry} Kc", gains.kc, axis.named(higher("control.anti_windup"))),
    )


def _towards(format_: FixedPoint, entry: str, value: float) -> Remedy:
    """Remedy of a number that is proportional to an entry."""
    return lower(entry) if abs(value) > format_.maximum else higher(entry)


@dataclass(frozen=True)
class Converter:
    """Conversion of the values of one axis."""

    axis: Axis
    board: Board
    s: Scales

    def at(self, format_: FixedPoint, path: str, scale: float) -> int:
        """Raw number of an entry of the axis times `scale`."""
        value = self.axis(path) * scale
        change = self.axis.named(_towards(format_, path, value))
        return format_.raw(self.axis.entry(path), value, change, given=self.axis(path))

    def board_at(self, format_: FixedPoint, key: str, scale: float) -> int:
        """Raw number of an entry of [board] times `scale`."""
        entry, value = f"board.{key}", self.board(key) * scale
        return format_.raw(entry, value, _towards(format_, entry, value), given=self.board(key))

    def ticks(self, path: str) -> int:
        """Raw number of a time, in slow ticks."""
        return self.at(TICKS, path, 1.0 / self.board.tick)

    def of(self, format_: FixedPoint, name: str, value: float, *remedies: Remedy | str) -> int:
        """Raw number of a value that depends on several entries, in units of full scale."""
        return format_.raw(f"{self.axis.name}: {name}", value, *map(self.axis.named, remedies))
