"""Samples of the board for the bridge: 64-bit positions and the state of every axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

from servo_msgs_py.catalogue import AXES, Catalogue, Variable, axis_name
from servo_msgs_py.convert import columns, state_label
from servo_msgs_py.units import SLOW_PERIODS, unwrap_u32

from servo_bridge.wire.scope import Sample

_READY_STATES = ("RUN/SPIN", "RUN/STARTUP")
"""States in which an axis accepts set-points."""

_RATE_MIN, _RATE_MAX = 100.0, 200.0
"""Rates of samples for controllers [Hz]: a write needs a sample, and a stream has a point every 10 ms; the upper one
takes a fifth of a core."""

_PASSING = 2 * SLOW_PERIODS
"""PWM periods after which an axis in RUN/READY waits for a set-point."""

_COMMON = ("tick", "applied_tick", "applied_count")
_PER_AXIS = ("position", "speed", "i_q", "state", "substate", "faults")


def rate_for_controllers(update_rate: float) -> float:
    """Rate of the samples that controllers with an update rate need [Hz]: one state per update, within bounds.

    More of them would take time of the line and of the computer from the set-points; a slow line carries fewer.
    """
    return min(max(update_rate, _RATE_MIN), _RATE_MAX)


def required_variables() -> list[str]:
    """Variables that the bridge requires in every sample."""
    return [*_COMMON, *(f"{axis_name(axis)}.{name}" for axis in range(AXES) for name in _PER_AXIS)]


def telemetry_variables(catalogue: Catalogue, extra: Sequence[str]) -> list[str]:
    """All variables of a sample, the required ones first.

    Raises
    ------
    ValueError
        If a variable is unknown or a block.
    """
    names = list(dict.fromkeys([*required_variables(), *extra]))
    for name in names:
        try:
            variable = catalogue[name]
        except KeyError as error:
            raise ValueError(error.args[0]) from None
        if variable.size == 0:
            raise ValueError(f"{name} is a block of bytes; write the variables in it")
    return names


@dataclass(frozen=True)
class AxisStatus:
    """State of one axis in the newest telemetry."""

    label: str  # state and substate, for messages
    accepts_set_points: bool  # RUN/SPIN, RUN/STARTUP; RUN/READY if a set-point starts the axis (no encoder)
    faulted: bool = False  # state FAULT
    position: int = 0  # of the shaft [counts], extended beyond the 32 bits of the board
    position_ref: int | None = None  # position set-point, extended [counts]; None: not in the telemetry
    speed: float = 0.0  # of the shaft [rad/s]


@dataclass(frozen=True)
class Snapshot:
    """One sample."""

    tick: int  # PWM periods since reset, extended beyond 32 bits
    epoch: int  # number of board resets; ticks and positions of different epochs are not comparable
    stamp_ns: int  # ROS time of the tick [ns]
    values: Mapping[str, float]
    """SI values by column, in the order of `Telemetry.columns`; tick and positions are extended beyond the 32 bits of
    the board."""
    applied_tick: int  # uint32, as sent by the board
    applied_count: int  # uint16, as sent by the board
    axes: tuple[AxisStatus, ...]  # state of every axis
    faults: tuple[int, ...]  # fault word of every axis
    backlog: bool = False  # the bridge was blocked, and much newer samples wait


@dataclass(frozen=True)
class _AxisColumns:
    """Indices of the variables of one axis in a sample."""

    position: int
    position_ref: int | None
    speed: int
    state: int
    substate: int
    faults: int


class Telemetry:
    """Converts samples to snapshots and extends the positions beyond the 32 bits of the board.

    Parameters
    ----------
    catalogue : Catalogue
        Names of states.
    variables : sequence of Variable
        Variables of a sample, in order; at least `required_variables`.
    """

    def __init__(self, catalogue: Catalogue, variables: Sequence[Variable]) -> None:
        self.columns = columns(variables)
        self._scales = [v.lsb for v in variables for _ in range(v.count)]
        where = {name: k for k, name in enumerate(self.columns)}
        self._tick, self._applied_tick, self._applied_count = (where[name] for name in _COMMON)
        self._axes = [
            _AxisColumns(
                where[f"{prefix}.position"],
                where.get(f"{prefix}.position_ref"),
                where[f"{prefix}.speed"],
                where[f"{prefix}.state"],
                where[f"{prefix}.substate"],
                where[f"{prefix}.faults"],
            )
            for prefix in map(axis_name, range(AXES))
        ]
        self._label = cache(partial(state_label, catalogue))
        self._lsb = catalogue[f"{axis_name(0)}.position"].lsb
        self._counts: list[int | None] = [None] * AXES
        self._ready_since: list[int | None] = [None] * AXES
        self._epoch = 0

    def snapshot(self, sample: Sample, stamp_ns: int, *, backlog: bool = False) -> Snapshot:
        """Convert a sample; `stamp_ns`: ROS time of its tick."""
        if sample.epoch != self._epoch:
            self._counts = [None] * AXES
            self._ready_since = [None] * AXES
        self._epoch = sample.epoch
        raw = sample.raw
        row = [number * scale for number, scale in zip(raw, self._scales, strict=True)]
        row[self._tick] = sample.tick
        axes: list[AxisStatus] = []
        for axis, at in enumerate(self._axes):
            before = self._counts[axis]
            counts = raw[at.position] if before is None else unwrap_u32(raw[at.position] & 0xFFFF_FFFF, before)
            self._counts[axis] = counts
            row[at.position] = counts * self._lsb
            reference = None
            if at.position_ref is not None:
                reference = unwrap_u32(raw[at.position_ref] & 0xFFFF_FFFF, counts)
                row[at.position_ref] = reference * self._lsb
            label = self._label(raw[at.state], raw[at.substate])
            ready = label in _READY_STATES or self._waits_in_ready(axis, label, sample.tick)
            axes.append(AxisStatus(label, ready, label == "FAULT", counts, reference, row[at.speed]))
        return Snapshot(
            sample.tick,
            sample.epoch,
            stamp_ns,
            dict(zip(self.columns, row, strict=True)),
            raw[self._applied_tick],
            raw[self._applied_count],
            tuple(axes),
            tuple(raw[at.faults] for at in self._axes),
            backlog,
        )

    def restart_position(self, axis: int) -> None:
        """Restart the extension of the position of an axis, whose reference has changed."""
        self._counts[axis] = None

    def _waits_in_ready(self, axis: int, label: str, tick: int) -> bool:
        """True if a sensorless axis waits in RUN/READY for the speed set-point that starts it.

        An axis with an encoder leaves RUN/READY within one slow tick.
        """
        since = self._ready_since[axis]
        if label != "RUN/READY":
            self._ready_since[axis] = None
            return False
        if since is None:
            self._ready_since[axis] = tick
            return False
        return tick - since > _PASSING
