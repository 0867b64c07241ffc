"""Recorder of a target: samples of some variables in its memory, at the rate of its control loops.

Points are recorded in a ring buffer until the trigger, and after it until the buffer has the requested number of points
before the trigger. This module has the data and the interface of both protocol versions.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final, Protocol

from servo_bridge.freemaster.commands import SCOPE_SIZES, ScopeSlot
from servo_bridge.freemaster.errors import RecorderError

_MEMORY_MAX: Final = 1 << 24


class Compare(Enum):
    """Comparison of a variable with the threshold of a trigger."""

    UNSIGNED = 1
    SIGNED = 2
    FLOAT = 3


class State(Enum):
    """State of a recorder."""

    UNCONFIGURED = 0
    EMPTY = 1
    RUNNING = 2
    CUT_SHORT = 3
    """Stopped before its memory was filled once."""
    FULL = 4


@dataclass(frozen=True)
class Trigger:
    """Trigger condition."""

    slot: ScopeSlot  # variable that is compared with the threshold
    compare: Compare  # interpretation of its bits
    above: bool  # on a rise to the threshold or above
    below: bool  # on a fall below the threshold
    threshold: int = 0  # raw number of the target; for `Compare.FLOAT` the bits of the number
    threshold_address: int | None = None  # address of a variable of the same type used as threshold
    level: bool = False  # level instead of edge: also if the condition holds from the start


@dataclass(frozen=True)
class Setup:
    """Configuration of a recording.

    Raises
    ------
    RecorderError
        If the entries contradict each other.
    """

    slots: tuple[ScopeSlot, ...]  # variables in the order of a point
    points: int = 0  # number of points; 0: as many as fit the memory
    before: int = 0  # points before the trigger
    divider: int = 1  # record every n-th sample of the target
    trigger: Trigger | None = None  # None: record until `Recorder.stop`

    def __post_init__(self) -> None:
        if not self.slots:
            raise RecorderError("nothing to record: write a variable")
        sizes = [slot.size for slot in self.slots] + ([self.trigger.slot.size] if self.trigger else [])
        if any(size not in SCOPE_SIZES for size in sizes):
            raise RecorderError("a recorder supports variables of 1, 2, 4 or 8 bytes")
        if self.points < 0 or self.before < 0 or self.divider < 1:
            raise RecorderError(f"{self.points} points, {self.before} before the trigger, divider {self.divider}")
        if self.points and self.before >= self.points:
            raise RecorderError(f"{self.before} points before the trigger are not less than all {self.points}")

    @property
    def point_size(self) -> int:
        """Bytes of one point."""
        return sum(slot.size for slot in self.slots)


@dataclass(frozen=True)
class Limits:
    """Limits of a recorder."""

    name: str  # of the recorder, may be empty
    memory: int | None  # bytes for samples and administration data; None: not reported
    period_ns: int  # time between two samples without divider [ns]; 0: not reported
    overhead: int = 0  # bytes of `memory` for administration data
    slot_overhead: int = 0  # bytes of `memory` for administration data per variable
    slots_max: int | None = None  # largest number of variables; None: not reported
    divider_max: int = (1 << 32) - 1  # largest number in a request
    points_max: int = (1 << 32) - 1  # largest number in a request

    def capacity(self, setup: Setup) -> int | None:
        """Number of points that fit; None if the memory size is not reported."""
        if self.memory is None:
            return None
        extra = setup.trigger is not None and setup.trigger.slot not in setup.slots
        used = self.overhead + self.slot_overhead * (len(setup.slots) + extra)
        return min(max(self.memory - used, 0) // setup.point_size, self.points_max)

    def check(self, setup: Setup) -> None:
        """Refuse a configuration that exceeds the limits.

        Raises
        ------
        RecorderError
            With the limit.
        """
        if self.slots_max is not None and len(setup.slots) > self.slots_max:
            raise RecorderError(f"{len(setup.slots)} variables are too many; the recorder supports {self.slots_max}")
        if setup.divider > self.divider_max:
            raise RecorderError(f"the recorder cannot divide its rate by {setup.divider}; at most {self.divider_max}")
        capacity = self.capacity(setup)
        if capacity is not None and capacity < max(setup.points, 2):
            raise too_many_points(setup, capacity)


def too_many_points(setup: Setup, fitting: int) -> RecorderError:
    """Error for too many points, with the number that fits."""
    if fitting < 2:
        return RecorderError(f"{len(setup.slots)} variables do not fit the memory of the recorder; record fewer")
    return RecorderError(
        f"{setup.points} points of {len(setup.slots)} variable(s) do not fit the memory of the recorder; "
        f"{fitting} points fit"
    )


@dataclass(frozen=True)
class SampleMemory:
    """Location of the points in memory."""

    address: int  # of the first point in memory
    point_size: int  # bytes of one point
    count: int  # number of points
    first: int  # index of the oldest point

    @property
    def size(self) -> int:
        """Bytes of all points."""
        return self.count * self.point_size


class Recorder(Protocol):
    """Recorder of a target."""

    def limits(self) -> Limits:
        """Read the limits."""

    def configure(self, setup: Setup) -> int:
        """Configure the recorder; a running recording is lost.

        Returns
        -------
        int
            Number of points that it will record.

        Raises
        ------
        RecorderError
            If the recorder does not support the configuration.
        """

    def start(self) -> None:
        """Start a recording; previous points are lost."""

    def stop(self) -> None:
        """End the recording without a trigger; it may continue as long as after a trigger."""

    def state(self) -> State:
        """Read the state."""

    def memory(self) -> SampleMemory:
        """Read the location of the points; only if the recorder is stopped."""


def memory_checked(memory: SampleMemory) -> SampleMemory:
    """Refuse an implausible memory.

    Raises
    ------
    RecorderError
        With the reported values.
    """
    if memory.size > _MEMORY_MAX or not 0 <= memory.first < max(memory.count, 1):
        raise RecorderError(
            f"the board reports {memory.count} points of {memory.point_size} bytes, the oldest at {memory.first}; "
            "this is not plausible"
        )
    return memory


def in_order(memory: SampleMemory, data: bytes) -> bytes:
    """Points of a whole memory, the oldest first."""
    start = memory.first * memory.point_size
    return bytes(data[start:] + data[:start])
