"""The recorder of a target: samples of a few variables in its own memory, at the rate of its loops.

Points are sampled into a ring until a trigger fires, and then until the ring holds as many points from before the
trigger as were asked for. Pure data, and the interface that both versions of the protocol have.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final, Protocol

from servo_bridge.freemaster.commands import SCOPE_SIZES, ScopeSlot
from servo_bridge.freemaster.errors import RecorderError

_MEMORY_MAX: Final = 1 << 24


class Compare(Enum):
    """How the target compares a variable with the threshold of a trigger."""

    UNSIGNED = 1
    SIGNED = 2
    FLOAT = 3


class State(Enum):
    """What a recorder does."""

    UNCONFIGURED = 0
    EMPTY = 1
    RUNNING = 2
    CUT_SHORT = 3
    """Stopped before its memory was full once."""
    FULL = 4


@dataclass(frozen=True)
class Trigger:
    """When to stop recording."""

    slot: ScopeSlot  # variable that is compared with the threshold
    compare: Compare  # interpretation of its bits
    above: bool  # fire when the variable reaches the threshold from below
    below: bool  # fire when the variable falls below the threshold
    threshold: int = 0  # raw number of the target; for `Compare.FLOAT` the bits of the number
    threshold_address: int | None = None  # address of a variable of the same type that is the threshold instead
    level: bool = False  # fire also when the condition holds from the beginning; else only when it comes true


@dataclass(frozen=True)
class Setup:
    """What to record.

    Raises
    ------
    RecorderError
        If it contradicts itself.
    """

    slots: tuple[ScopeSlot, ...]  # variables in the order in which a point holds them
    points: int = 0  # number of points; 0: as many as fit
    before: int = 0  # points before the trigger
    divider: int = 1  # record every so many-th of the samples that the target could record
    trigger: Trigger | None = None  # None: record until `Recorder.stop`

    def __post_init__(self) -> None:
        if not self.slots:
            raise RecorderError("there is nothing to record: name a variable")
        sizes = [slot.size for slot in self.slots] + ([self.trigger.slot.size] if self.trigger else [])
        if any(size not in SCOPE_SIZES for size in sizes):
            raise RecorderError("a recorder takes variables of 1, 2, 4 or 8 bytes")
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
    """What a recorder can do."""

    name: str  # of the recorder, may be empty
    memory: int | None  # bytes for samples and the target's own data about them; None: not stated
    period_ns: int  # time between two samples without divider [ns]; 0: not stated
    overhead: int = 0  # bytes of `memory` for the target's own data
    slot_overhead: int = 0  # bytes of `memory` for the target's own data per variable
    slots_max: int | None = None  # largest number of variables; None: not stated
    divider_max: int = (1 << 32) - 1  # largest number that a request can carry
    points_max: int = (1 << 32) - 1  # largest number that a request can carry

    def capacity(self, setup: Setup) -> int | None:
        """Count the points that fit; None when the target does not say how much memory it has."""
        if self.memory is None:
            return None
        extra = setup.trigger is not None and setup.trigger.slot not in setup.slots
        used = self.overhead + self.slot_overhead * (len(setup.slots) + extra)
        return min(max(self.memory - used, 0) // setup.point_size, self.points_max)

    def check(self, setup: Setup) -> None:
        """Refuse what cannot be recorded.

        Raises
        ------
        RecorderError
            With what can.
        """
        if self.slots_max is not None and len(setup.slots) > self.slots_max:
            raise RecorderError(f"{len(setup.slots)} variables are too many; the recorder takes {self.slots_max}")
        if setup.divider > self.divider_max:
            raise RecorderError(f"the recorder cannot divide its rate by {setup.divider}; at most {self.divider_max}")
        capacity = self.capacity(setup)
        if capacity is not None and capacity < max(setup.points, 2):
            raise too_many_points(setup, capacity)


def too_many_points(setup: Setup, fitting: int) -> RecorderError:
    """Say that the points do not fit, and how many do."""
    if fitting < 2:
        return RecorderError(f"{len(setup.slots)} variables do not fit the memory of the recorder; record fewer")
    return RecorderError(
        f"{setup.points} points of {len(setup.slots)} variable(s) do not fit the memory of the recorder; "
        f"{fitting} points fit"
    )


@dataclass(frozen=True)
class SampleMemory:
    """Where the points lie."""

    address: int  # of the first point in memory
    point_size: int  # bytes of one point
    count: int  # number of points
    first: int  # index of the oldest point

    @property
    def size(self) -> int:
        """Bytes of all points."""
        return self.count * self.point_size


class Recorder(Protocol):
    """One recorder of one target."""

    def limits(self) -> Limits:
        """Ask what it can do."""

    def configure(self, setup: Setup) -> int:
        """Set it up; a recording that runs is lost.

        Returns
        -------
        int
            How many points it will take.

        Raises
        ------
        RecorderError
            If it cannot record that.
        """

    def start(self) -> None:
        """Begin to record; the points of before are lost."""

    def stop(self) -> None:
        """End the recording without waiting for the trigger; it may go on for as long as after a trigger."""

    def state(self) -> State:
        """Ask what it does."""

    def memory(self) -> SampleMemory:
        """Ask where the points lie; only when it is stopped."""


def memory_checked(memory: SampleMemory) -> SampleMemory:
    """Refuse a memory that cannot be.

    Raises
    ------
    RecorderError
        With what the target says.
    """
    if memory.size > _MEMORY_MAX or not 0 <= memory.first < max(memory.count, 1):
        raise RecorderError(
            f"the board names {memory.count} points of {memory.point_size} bytes, the oldest at {memory.first}; "
            "that cannot be"
        )
    return memory


def in_order(memory: SampleMemory, data: bytes) -> bytes:
    """Points of a whole memory, oldest first."""
    turn = memory.first * memory.point_size
    return bytes(data[turn:] + data[:turn])
