"""One sample of the board as the rest of the bridge needs it: 64-bit positions and the state of every axis. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

from servo_msgs_py.catalogue import AXES, Catalogue, Variable, axis_name
from servo_msgs_py.convert import columns, state_label
from servo_msgs_py.units import SLOW_PERIODS, unwrap_u32

from servo_bridge.arbiter import AxisStatus
from servo_bridge.wire.scope import Sample

_OBEYS = ("RUN/SPIN", "RUN/STARTUP")
"""States in which an axis takes set-points."""

_PASSING = 2 * SLOW_PERIODS
"""An axis that stays in RUN/READY for more than so many PWM periods waits there."""

_COMMON = ("tick", "applied_tick", "applied_count")
_PER_AXIS = ("position", "speed", "i_q", "state", "substate", "faults")


def required_variables() -> list[str]:
    """Variables that the bridge itself needs in every sample."""
    return [*_COMMON, *(f"{axis_name(axis)}.{name}" for axis in range(AXES) for name in _PER_AXIS)]


def telemetry_variables(catalogue: Catalogue, extra: Sequence[str]) -> list[str]:
    """All variables of a sample, those that the bridge needs first.

    Raises
    ------
    ValueError
        If one is unknown or a block.
    """
    names = list(dict.fromkeys([*required_variables(), *extra]))
    for name in names:
        try:
            variable = catalogue[name]
        except KeyError as error:
            raise ValueError(error.args[0]) from None
        if variable.size == 0:
            raise ValueError(f"{name} is a block of bytes; name the variables inside it")
    return names


@dataclass(frozen=True)
class Snapshot:
    """One sample."""

    tick: int  # PWM periods since reset, extended past 32 bits
    epoch: int  # board resets seen before; ticks and positions of different epochs are unrelated
    response_ns: int  # monotonic host time at which the sample was complete [ns]
    values: Mapping[str, float]
    """SI values by column, in the order of `Telemetry.columns`; tick and positions are extended past the 32 bits of the
    board."""
    applied_tick: int  # as the board sent it: uint32
    applied_count: int  # as the board sent it: uint16
    axes: tuple[AxisStatus, ...]  # state of every axis
    faults: tuple[int, ...]  # fault word of every axis


@dataclass(frozen=True)
class _AxisColumns:
    """Where the variables of one axis lie in a sample."""

    position: int
    position_ref: int | None
    state: int
    substate: int
    faults: int


class Telemetry:
    """Turns samples into snapshots and follows the positions of all axes past the 32 bits of the board.

    Parameters
    ----------
    catalogue : Catalogue
        For the names of states.
    variables : sequence of Variable
        What a sample carries, in order; at least `required_variables`.
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

    def snapshot(self, sample: Sample) -> Snapshot:
        """Make a snapshot of a sample."""
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
            obeys = label in _OBEYS or self._waits(axis, label, sample.tick)
            axes.append(AxisStatus(label, obeys, label == "FAULT", counts, reference))
        return Snapshot(
            sample.tick,
            sample.epoch,
            sample.response_ns,
            dict(zip(self.columns, row, strict=True)),
            raw[self._applied_tick],
            raw[self._applied_count],
            tuple(axes),
            tuple(raw[at.faults] for at in self._axes),
        )

    def recount(self, axis: int) -> None:
        """The position of an axis counts from elsewhere from now on."""
        self._counts[axis] = None

    def _waits(self, axis: int, label: str, tick: int) -> bool:
        """Whether an axis without an encoder waits for the speed set-point that starts it.

        It does so in RUN/READY, through which an axis with an encoder passes within one slow tick.
        """
        since = self._ready_since[axis]
        if label != "RUN/READY":
            self._ready_since[axis] = None
            return False
        if since is None:
            self._ready_since[axis] = tick
            return False
        return tick - since > _PASSING
