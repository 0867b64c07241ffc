"""Samples of the board for the twin: ticks, raw positions, states, standstill."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from functools import cache, partial
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import state_label

from servo_msgs_py import topics

PER_BOARD: Final = frozenset({"tick", "applied_tick", "applied_count", "config.taken_tick"})
"""Counters that are independent on each board."""

ROTOR_REFERENCED: Final = ("position", "position_ref")
"""Positions of an axis, relative to the rotor position at the rotor search, which differs between the boards."""

ANGLE_DEPENDENT: Final = (
    *("theta_e", "estimate_theta_e", "pll_angle", "emf_alpha", "emf_beta"),
    *(f"{quantity}_{phase}" for quantity in ("i", "duty") for phase in "abc"),
)
"""Variables of an axis that are not comparable at different electrical angles."""

_COMMON: Final = ("tick", "applied_tick", "applied_count")
_PER_AXIS: Final = ("position", "speed", "i_q", "state", "substate")
_WHOLE: Final = ("position", "position_ref", "state", "substate", "faults", "limits", "home_state")
"""Quantities of an axis that a `Sample` has as raw numbers; 0 where the telemetry has none."""
_WHOLE_MAX: Final = 1 << 53  # larger numbers are not exact
_EXTENDED: Final = ("position", "position_ref")
"""Quantities of an axis that the bridge extends beyond the 32 bits of the board, as it does the tick."""
_REST_COUNTS: Final = 2  # of the encoder or the position; the controller does not correct an error of one count


class Activity(Enum):
    """Class of states in which two boards are comparable."""

    IDLE = "off or coasting"
    SEARCHING = "searching its rotor"
    ACTIVE = "under control"


_ACTIVITIES: Final = {
    "RUN/CALIB": Activity.SEARCHING,
    "RUN/READY": Activity.SEARCHING,
    "RUN/ALIGN": Activity.SEARCHING,
    "RUN/STARTUP": Activity.SEARCHING,
    "RUN/TEST": Activity.SEARCHING,
    "RUN/SPIN": Activity.ACTIVE,
}


def activity(label: str) -> Activity:
    """Activity of a state label such as ``RUN/SPIN``."""
    return _ACTIVITIES.get(label, Activity.IDLE)


def expired_mask(catalogue: Catalogue) -> int:
    """Mask of the limits EXPIRED (no set-point) and STARVED (no trajectory point)."""
    return sum(flag.mask for flag in catalogue.flags["limits"] if flag.name in ("EXPIRED", "STARVED"))


class Sample(NamedTuple):
    """One sample of the real board."""

    tick: int  # PWM periods since reset, extended past 32 bits
    stamp_ns: int  # ROS time of the tick [ns]
    applied_tick: int  # variable of the board, uint32
    applied_count: int  # variable of the board, uint16
    labels: tuple[str, ...]  # state of every axis, such as ``STOP`` or ``RUN/SPIN``
    position: tuple[int, ...]  # per axis [counts]
    position_ref: tuple[int, ...]  # shaped set-point of every axis [counts]
    faults: tuple[int, ...]  # captured faults of every axis; 0: not in the telemetry
    expired: tuple[bool, ...]  # per axis, true after a stop by the timeout of the set-point
    home_states: tuple[int, ...]  # validity of the position of every axis (home_state_t); 0: not in the telemetry
    values: Mapping[str, float]  # all values of the sample, SI, by column name


class SampleReader:
    """Converts the rows of telemetry tables to samples.

    Parameters
    ----------
    catalogue : Catalogue
        For scaling and names of states.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._axes = [axis_name(axis) for axis in range(AXES)]
        self._label = cache(partial(state_label, catalogue))
        self._expired = expired_mask(catalogue)
        # Names and resolutions of the raw numbers, in the order of `_sample`.
        self._names = [*_COMMON, *topics.STAMP_COLUMNS, *(f"{axis}.{name}" for name in _WHOLE for axis in self._axes)]
        self._lsb = [catalogue[name].lsb if name in catalogue.variables else 1.0 for name in self._names]
        self._catalogue = catalogue
        self._bounds = np.empty((2, 0))  # smallest and largest value by column of the last table
        self._columns: Sequence[str] = ()  # of the last table
        self._pick: Callable[[Sequence[float]], Sequence[float]] = tuple  # raw numbers of a row with a 0 behind it

    def rows(self, columns: Sequence[str], table: NDArray[np.float64]) -> list[Sample]:
        """One sample per row of a table (samples, columns), SI.

        Raises
        ------
        ValueError
            If a required column is missing, or a number is none that a board sends.
        """
        if columns != self._columns:
            self._pick = itemgetter(*self._placed(columns))
            self._bounds = np.array([self._bounds_of(name) for name in columns]).T
            self._columns = columns
        low, high = self._bounds
        valid = (table >= low) & (table <= high)
        if not valid.all():
            row, column = np.argwhere(~valid)[0]
            raise ValueError(f"a sample has the {columns[column]} {table[row, column]:g}, which no board sends")
        return [self._sample(dict(zip(columns, row, strict=True)), self._numbers(row)) for row in table.tolist()]

    def _bounds_of(self, column: str) -> tuple[float, float]:
        """Smallest and largest value of a column; finite."""
        name = column.partition("[")[0]
        if column in topics.STAMP_COLUMNS or name == "tick":
            return 0.0, float(_WHOLE_MAX)
        variable = self._catalogue.variables.get(name)
        if variable is None:
            return -sys.float_info.max, sys.float_info.max
        if name.partition(".")[2] in _EXTENDED:
            return -_WHOLE_MAX * variable.lsb, _WHOLE_MAX * variable.lsb
        low, high = variable.format.low, variable.format.high
        return (low - 0.5) * variable.lsb, (high + 0.5) * variable.lsb

    def _numbers(self, row: list[float]) -> list[int]:
        """Raw numbers in a row, in the order of `_names`."""
        return [round(value / lsb) for value, lsb in zip(self._pick([*row, 0.0]), self._lsb, strict=True)]

    def _placed(self, columns: Sequence[str]) -> list[int]:
        """Places of the raw numbers in the rows of a table."""
        needed = [*_COMMON, *topics.STAMP_COLUMNS, *(f"{a}.{name}" for a in self._axes for name in _PER_AXIS)]
        missing = [name for name in needed if name not in columns]
        if missing:
            raise ValueError(f"the snapshot has no {', '.join(missing)}, which the twin requires")
        places = {name: place for place, name in enumerate(columns)}
        for axis in self._axes:
            places.setdefault(f"{axis}.position_ref", places[f"{axis}.position"])
        return [places.get(name, len(columns)) for name in self._names]

    def _sample(self, values: Mapping[str, float], numbers: list[int]) -> Sample:
        tick, applied_tick, applied_count, second, nanosecond, *per_axis = numbers
        by_quantity = zip(*[iter(per_axis)] * AXES, strict=True)
        position, reference, states, substates, faults, limits, home_states = by_quantity
        return Sample(
            tick,
            second * 1_000_000_000 + nanosecond,
            applied_tick,
            applied_count,
            tuple(map(self._label, states, substates)),
            position,
            reference,
            faults,
            tuple([bool(word & self._expired) for word in limits]),
            home_states,
            values,
        )


class StandstillDetector:
    """Detects the standstill of the shafts.

    Parameters
    ----------
    ticks : int
        Required time of standstill [PWM periods].
    resolution : sequence of int
        Position counts per count of the encoder, by axis; the owner may change them.
    """

    def __init__(self, ticks: int, resolution: Sequence[int] = (1,) * AXES) -> None:
        self._ticks = ticks
        self._resolution = resolution
        self._samples: deque[tuple[int, tuple[int, ...]]] = deque()

    def forget(self) -> None:
        """Discard the samples."""
        self._samples.clear()

    def add(self, tick: int, position: tuple[int, ...]) -> None:
        """Add the positions of all axes [counts]."""
        self._samples.append((tick, position))
        # Keep one sample older than the required time, so that the samples span it.
        while len(self._samples) > 1 and self._samples[1][0] <= tick - self._ticks:
            self._samples.popleft()

    def at_rest(self, axis: int) -> bool:
        """True if the shaft of an axis has been at standstill for the required time."""
        if not self._samples or self._samples[-1][0] - self._samples[0][0] < self._ticks:
            return False
        positions = [position[axis] for _, position in self._samples]
        return max(positions) - min(positions) <= _REST_COUNTS * self._resolution[axis]
