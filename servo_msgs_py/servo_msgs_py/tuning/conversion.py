"""From SI units to the integers of ``axis_config_t``; every refusal names the entry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from servo_msgs_py.tuning.configuration import Axis, Board, Scales
from servo_msgs_py.tuning.formats import GAIN, Format
from servo_msgs_py.tuning.gains import Pi

TICKS: Final = Format("uint16_t slow ticks", 0, 0, 2**16 - 2)
"""A counter of 16 bits has to be able to go beyond it."""


class PiRaw(NamedTuple):
    """A ``pi_gains_t``."""

    kp: int
    ki: int
    kc: int


class FaultSet(tuple[str, ...]):
    """Faults, by their names in the contract, lower case."""


class Category(str):
    """A stop category."""


class Switches(tuple[str, ...]):
    """Features that are on, by their names in the contract."""


Field = int | tuple[int, ...] | PiRaw | Switches | FaultSet | Category
AxisConstants = Mapping[str, Field]
"""C path of every field of ``axis_config_t`` with its value."""


def pi_raw(axis: Axis, name: str, gains: Pi, scale: float, remedy: str) -> PiRaw:
    """Raw gains of a PI controller; `scale` turns gains in SI into full scale over full scale."""
    entry = f"{axis.name}: {name}"
    return PiRaw(
        GAIN.raw(f"{entry} Kp", gains.kp * scale, remedy),
        GAIN.raw(f"{entry} Kp Ki Ts", gains.ki * scale, remedy),
        GAIN.raw(f"{entry} Kc", gains.kc, "raise control.anti_windup"),
    )


@dataclass(frozen=True)
class Converter:
    """Shorthand for one axis: every method names the entry in its refusal."""

    axis: Axis
    board: Board
    s: Scales

    def at(self, format_: Format, path: str, scale: float, remedy: str = "correct it") -> int:
        """An entry of the configuration times `scale`."""
        return format_.raw(self.axis.entry(path), self.axis(path) * scale, remedy, self.axis(path))

    def board_at(self, format_: Format, key: str, scale: float, remedy: str) -> int:
        """An entry of [board] times `scale`."""
        return format_.raw(f"board.{key}", self.board(key) * scale, remedy, self.board(key))

    def ticks(self, path: str) -> int:
        """A time in slow ticks."""
        tick = self.board.tick
        return self.at(TICKS, path, 1.0 / tick, f"write seconds, {tick:g} .. {TICKS.high * tick:g}")

    def of(self, format_: Format, name: str, value: float, remedy: str) -> int:
        """Raw number of a value of full scale that follows from several entries."""
        return format_.raw(f"{self.axis.name}: {name}", value, remedy)
