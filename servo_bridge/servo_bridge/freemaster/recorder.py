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
    """When to stop recording.

    Attributes
    ----------
    slot : ScopeSlot
        Variable that is compared with the threshold.
    compare : Compare
        Reading of its bits.
    above, below : bool
        Fire when the variable reaches the threshold from below; when it falls below the threshold.
    threshold : int
        Raw number of the target; of a `Compare.FLOAT` the bits of the number.
    threshold_address : int or None
        Address of a variable of the same type that is the threshold instead.
    level : bool
        Fire also when the condition holds from the beginning; else only when it comes true.
    """

    slot: ScopeSlot
    compare: Compare
    above: bool
    below: bool
    threshold: int = 0
    threshold_address: int | None = None
    level: bool = False


@dataclass(frozen=True)
class Setup:
    """What to record.

    Attributes
    ----------
    slots : tuple of ScopeSlot
        Variables in the order in which a point holds them.
    points : int
        Points in all; 0: as many as fit.
    before : int
        Points before the trigger.
    divider : int
        Take every so many-th of the samples that the target could take.
    trigger : Trigger or None
        None: record until `Recorder.stop`.

    Raises
    ------
    RecorderError
        If it contradicts itself.
    """

    slots: tuple[ScopeSlot, ...]
    points: int = 0
    before: int = 0
    divider: int = 1
    trigger: Trigger | None = None

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
    """What a recorder can do.

    Attributes
    ----------
    name : str
        Its name, may be empty.
    memory : int or None
        Bytes for samples and what the target notes about them; None when it does not say.
    period_ns : int
        Time between two samples without divider [ns]; 0 when the target does not say.
    overhead, slot_overhead : int
        Bytes of `memory` that the target needs for itself, and for each variable.
    slots_max : int or None
        Most variables; None when the target does not say.
    divider_max, points_max : int
        Largest numbers that a request can carry.
    """

    name: str
    memory: int | None
    period_ns: int
    overhead: int = 0
    slot_overhead: int = 0
    slots_max: int | None = None
    divider_max: int = (1 << 32) - 1
    points_max: int = (1 << 32) - 1

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
    """Where the points lie.

    Attributes
    ----------
    address : int
        Of the first point in memory.
    point_size : int
        Bytes of one.
    count : int
        How many there are.
    first : int
        Index of the oldest.
    """

    address: int
    point_size: int
    count: int
    first: int

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
