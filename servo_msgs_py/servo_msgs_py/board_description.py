"""Descriptions of the boards (``boards/NAME.toml``): what the hardware of a board gives, as typed objects.

A process works with one board: `DEFAULT_BOARD`, or that of the environment variable `VARIABLE`.
"""

from __future__ import annotations

import errno
import math
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.text_file import read_toml

DEFAULT_BOARD: Final = "mc56f84789"
"""Board of the firmware and of the virtual board. Firmware and configurations that name no board are for it."""

VARIABLE: Final = "SERVO_BOARD"
"""Environment variable with the name of the board of this process, or with the file of its description, NAME.toml."""

RANGES: Final = ("bus_voltage", "current")
"""Measured quantities, by the names that variables.toml uses."""

FIRMWARE: Final = "servo"
"""Name of the firmware. It reports ``servo/BOARD``, and before it knew the name of its board, ``servo``."""

_FOLDER: Final = Path(__file__).with_name("boards")


class OtherBoardError(ValueError):
    """A board has no description, or is not the expected one; the message contains its name and the known ones."""


@dataclass(frozen=True, kw_only=True)
class BoardDescription:
    """What the hardware of one board gives."""

    name: str
    pwm_frequency: float  # carrier of the inverters and rate of the fast loop [Hz]
    dead_time: float  # time with both switches of a leg open, per edge [s]
    switch_drop: float  # voltage drop of a switch or diode [V]
    timer_clock: float  # clock of the encoder edge timer [Hz]
    encoder_filter: float  # shortest level of an encoder channel that passes the input filter [s]
    shunts: int  # phases with a shunt: 3, or 2 for phases b and c
    low_side_time: float  # shortest low-side time of a phase whose current is sampled at its centre [s]
    over_current: float  # limit of a phase current that the port applies [A]; 0: the hardware has a comparator
    flash_sectors: int  # sectors for both copies of the stored set
    flash_sector_words: int  # 32-bit words of a sector
    ranges: Mapping[str, float]  # full scales of the quantities `RANGES`, SI

    def __post_init__(self) -> None:
        positive = {key: getattr(self, key) for key in ("pwm_frequency", "timer_clock", "encoder_filter")}
        for key, value in {**positive, **{f"ranges.{name}": scale for name, scale in self.ranges.items()}}.items():
            if not 0.0 < value < math.inf:
                raise ValueError(f"{key} = {value!r} is not a finite number above 0")
        if not 0.0 <= self.dead_time < 0.5 * self.period:
            raise ValueError(f"two dead times of {self.dead_time:g} s fill the PWM period")
        if self.shunts not in (2, 3):
            raise ValueError(f"shunts = {self.shunts!r} is neither 2 nor 3")
        if not 0.0 <= self.low_side_time < self.period:
            raise ValueError(f"low_side_time = {self.low_side_time:g} s is no part of the PWM period")
        if not 0.0 <= self.over_current < self.ranges["current"]:
            raise ValueError(f"over_current = {self.over_current:g} A cannot be measured")
        if not 0.0 <= self.switch_drop < self.ranges["bus_voltage"]:
            raise ValueError(f"switch_drop = {self.switch_drop:g} V is no part of the bus voltage")
        for key in ("flash_sectors", "flash_sector_words"):
            if not isinstance(getattr(self, key), int):
                raise ValueError(f"{key} = {getattr(self, key)!r} is not a whole number")
        if self.flash_sectors < 2 or self.flash_sectors * self.flash_sector_words > 0x10000:
            raise ValueError(f"{self.flash_sectors} sectors do not hold two copies of up to 65536 words")
        if abs(1e9 * self.period - self.period_ns) > 1e-3:
            raise ValueError(f"a PWM period of {self.period!r} s is no whole number of nanoseconds")

    @property
    def period(self) -> float:
        """PWM period [s]."""
        return 1.0 / self.pwm_frequency

    @property
    def period_ns(self) -> int:
        """PWM period [ns]."""
        return round(1e9 / self.pwm_frequency)

    @property
    def voltage_use_max(self) -> float:
        """Largest part of the linear range of the modulation that leaves every low side its time for sampling."""
        return 1.0 - 2.0 * self.low_side_time / self.period

    @classmethod
    def parse(cls, name: str, table: Mapping[str, Any]) -> BoardDescription:
        """Description from the parsed file.

        Raises
        ------
        ValueError
            If an entry is missing, unknown, no number or out of range; the message does not have the name.
        """
        known = {field.name for field in fields(cls)} - {"name", "ranges"} | {f"ranges.{key}" for key in RANGES}
        given = dict(table)
        if isinstance(ranges := given.get("ranges"), Mapping):
            del given["ranges"]
            given |= {f"ranges.{key}": value for key, value in ranges.items()}
        if wrong := sorted(known ^ set(given)):
            raise ValueError(f"missing or unknown: {', '.join(wrong)}")
        for key, value in given.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise ValueError(f"{key} = {value!r} is not a number")
        return cls(name=name, **table)

    @classmethod
    def load(cls, name: str | None = None) -> BoardDescription:
        """Description of a board by its name or file; by default of the board of this process.

        Raises
        ------
        OtherBoardError
            If there is none of this name, or its file is not complete.
        """
        name = name or os.environ.get(VARIABLE) or DEFAULT_BOARD
        path = Path(name) if name.endswith(".toml") else _FOLDER / f"{name}.toml"
        try:
            if not stat.S_ISREG(path.stat().st_mode):
                raise OSError(errno.EINVAL, "it is no file")
            return cls.parse(path.stem, read_toml(path))
        except OSError as error:
            text = f"there is no description of the board {name!r}: {error.strerror}; {_known()}"
            raise OtherBoardError(text) from None
        except ValueError as error:
            raise OtherBoardError(f"{path}: {error}") from None


def board_of(reported: str) -> str | None:
    """Board of a target by the name that its firmware reports; None: another firmware."""
    firmware, _, board = reported.partition("/")
    return (board or DEFAULT_BOARD) if firmware == FIRMWARE else None


def check_board(name: str, expected: BoardDescription) -> None:
    """Check that a board is the expected one.

    Raises
    ------
    OtherBoardError
        If it is not.
    """
    if name != expected.name:
        raise OtherBoardError(f"{name!r} is not the board {expected.name!r} of this program; {_known()}")


@lru_cache(maxsize=1)
def known_boards() -> tuple[str, ...]:
    """Names of the packaged descriptions."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))


def _known() -> str:
    return f"known are {', '.join(known_boards())}"
