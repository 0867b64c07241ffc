"""Admission of the set-points of ``joint_commands``: which of them may move a joint, and how they are executed.

A sender that publishes continuously, such as a controller of ros2_control, also publishes without a command of its
user: before a controller has started, after a stop, a fault, a restart, or after another source has moved the joint.
Such set-points must not move a shaft. rclpy does not report the publisher of a message, so the rules use the messages
of a joint only:

* Messages of a joint closer than `GAP` are a train, otherwise isolated.
* A path (position with velocity or effort) joins a joint only where it is: position and velocity within tolerances.
* A position alone is a command if it is isolated, that is, no other one within `GAP` before and after it; or if it
  differs by a step from the value that the train has held. The other messages of a train must join.
* A velocity or an effort alone is a command at the begin of a train. A train that continues from before the joint was
  released must be zero once.
* Position and velocity of one message may contradict each other, because one of them is the last command of a
  controller that has ended: a constant position with a velocity, or a step of the position at a constant velocity. The
  one that has changed last is executed.
* A path that follows a velocity ends it, also if the path does not join: the controller of the velocity has ended.

A joint is released by a stop, a fault, a lost link and the end of the enabled state. After its admission a train keeps
the joint until it is released or commanded otherwise.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from servo_bridge.set_point_sources import Source
from servo_bridge.set_points import JointSetPoint, Rejected

GAP: Final = 0.25
"""Time without a message that ends a train; delay of an isolated position [s]."""

JOIN_DISTANCE: Final = 0.05
"""Largest distance of a joint from a set-point at rest that joins it [rad]."""

JOIN_SPEED: Final = 0.2
"""Largest difference of the velocities when a path passes a joint that joins it [rad/s]."""

JOIN_TIME: Final = 0.1
"""A path that begins in motion may be ahead of the joint by its velocity times this time, about the delay of a stream
[s]."""

RESUME_TIME: Final = 0.5
"""The same for a stream that continues after messages or points were lost [s]."""

SETTLING: Final = 0.5
"""Time after a command of another source in which a path does not join: the motion has not begun [s]."""

_HERE: Final = 0.1 * JOIN_DISTANCE
"""A train that begins with a velocity this close to its joint is one of a velocity controller [rad]."""

_CLOCK_STEP: Final = 0.1
"""Longest step of the clock of the trains: a computer that was busy does not make a message isolated [s]."""

_CONTRADICTIONS: Final = 3
"""Messages that repeat a position with a velocity until that is a contradiction; fewer occur at the begin of a path."""

_HELD: Final = 3
"""Messages with the same position after which a step is a command."""


class NotJoined(Rejected):
    """A set-point was refused, because it does not begin where its joint is."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


@dataclass(frozen=True)
class Place:
    """State of a joint that a set-point wants to join."""

    joint: str  # name
    position: float  # of the shaft [rad]
    velocity: float  # of the shaft [rad/s]
    holder: Source | None  # source that commanded it last; None: none since it was released
    moved_by: str  # other topic that moves it now; empty: none
    streaming: bool  # whether it follows a stream
    wraps: bool = False  # whether positions that differ by whole turns are the same

    def distance(self, position: float) -> float:
        """Distance of the joint from a position [rad]."""
        return _distance(self.position, position, wraps=self.wraps)


class _Drive(Enum):
    """Quantity of a message with position and velocity that is executed."""

    PATH = "path"
    POSITION = "position"
    VELOCITY = "velocity"


@dataclass
class _Train:
    """Messages of one joint and one form that follow each other."""

    point: JointSetPoint  # the newest one
    time: float  # of the newest message, clock of the trains [s]
    stamp: float  # of the newest message [s]
    wraps: bool  # whether positions that differ by whole turns are the same
    before: JointSetPoint | None = None  # the one before it
    elapsed: float = 0.0  # between the stamps of both [s]
    same: int = 1  # newest messages with the same position
    held: int = 0  # messages with the position before the newest one
    steps: int = 0  # newest messages that step (`is_step`)
    drive: _Drive = _Drive.PATH
    contradictions: int = 0  # newest messages with the same position and a velocity
    velocity_commanded: bool = False  # whether the velocity has left zero at a constant position, or silence
    executed: bool = False  # whether a message has been executed since the joint was released
    old: bool = False  # whether it began before the joint was released last
    repeats: bool = False  # whether its first message repeats the last one of the train before it
    origin: float | None = None  # where the present motion has begun [rad]

    @property
    def step(self) -> float:
        """Distance of the newest position from the one before it [rad]; 0 without one of them."""
        before, position = None if self.before is None else self.before.position, self.point.position
        return 0.0 if before is None or position is None else _distance(before, position, wraps=self.wraps)

    @property
    def jumps(self) -> bool:
        """Whether the velocities do not explain the distance of the newest two positions."""
        before = None if self.before is None else self.before.velocity
        fastest = max(abs(before or 0.0), abs(self.point.velocity or 0.0))
        return self.step > 3.0 * fastest * max(self.elapsed, 0.0) + 0.2 * JOIN_DISTANCE

    @property
    def velocity_is_old(self) -> bool:
        """Whether the velocity, if any, is that of a controller before the one of the position."""
        return self.drive is _Drive.POSITION and not self.velocity_commanded

    def is_step(self) -> bool:
        """Whether only the position of the newest message has changed, at rest or beside an old velocity."""
        before, point = self.before, self.point
        if before is None or point.position == before.position:
            return False
        if not (point.velocity or before.velocity):
            return True
        old = self.velocity_is_old or (self.drive is _Drive.VELOCITY and self.jumps)
        return old and point.velocity == before.velocity

    def find_origin(self) -> None:
        """Update the origin with the newest message: a standstill, or a place that no motion leads to."""
        before, point = self.before, self.point
        began = before is None or before.position is None or point.position is None
        if began or not point.velocity or self.jumps:
            self.origin = point.position


@dataclass
class _Axis:
    """Messages of one axis."""

    trains: dict[bool, _Train] = field(default_factory=dict)  # of single quantities, and of paths (True)
    waiting: tuple[float, JointSetPoint] | None = None  # position that may be isolated, and its time [s]
    executed: tuple[bool, float] | None = None  # form of the newest executed message, and its time [s]
    barred: float | None = None  # position that was refused last [rad]
    released: bool = True  # whether the joint had no source at the newest message


@dataclass(frozen=True)
class Admitted:
    """What is executed of a message."""

    points: dict[int, JointSetPoint] = field(default_factory=dict)  # by axis
    refused: list[NotJoined] = field(default_factory=list)
    stop: list[int] = field(default_factory=list)  # axes whose stream or velocity ends: its messages contradict it


class Admission:
    """Applies the rules of this module to the messages of one topic.

    Parameters
    ----------
    topic : str
        Relative name.
    wrapping : collection of int
        Axes whose positions are angles: those of messages that differ by whole turns are the same.
    """

    def __init__(self, topic: str, wrapping: Collection[int] = ()) -> None:
        self._topic = topic
        self._wrapping = frozenset(wrapping)
        self._axes: defaultdict[int, _Axis] = defaultdict(_Axis)
        self._time = 0.0  # clock of the trains [s]
        self._advanced = math.inf  # time of the last step [s]

    def advance(self, now: float) -> dict[int, JointSetPoint]:
        """Advance the clock of the trains, several times per `GAP`; returns the isolated positions that are now due.

        Parameters
        ----------
        now : float
            Steady time [s].
        """
        self._time += min(max(now - self._advanced, 0.0), _CLOCK_STEP)
        self._advanced = now
        due = {}
        for number, axis in self._axes.items():
            if axis.waiting is not None and self._time - axis.waiting[0] >= GAP:
                due[number] = axis.waiting[1]
                axis.waiting, axis.executed, axis.barred = None, (False, self._time), None
                axis.trains[False].executed = True
        return due

    def observe(self, points: Mapping[int, JointSetPoint], stamp: float) -> None:
        """Register a message that is refused for another reason; arguments as in `decide`."""
        for axis, point in points.items():
            self._next(axis, point, stamp, released=True).old = True

    def decide(
        self,
        points: Mapping[int, JointSetPoint],
        stamp: float,
        places: Mapping[int, Place],
        *,
        command: bool = False,
    ) -> Admitted:
        """Return what is executed of a message.

        Parameters
        ----------
        points : mapping of int to JointSetPoint
            Of a message, by axis.
        stamp : float
            Time of the message [s].
        places : mapping of int to Place
            States of these axes.
        command : bool
            The message is known to be a single command: a position, velocity or effort alone is executed.
        """
        result = Admitted()
        for number, point in points.items():
            axis, place = self._axes[number], places[number]
            train = self._next(number, point, stamp, released=place.holder is None)
            follows_velocity = self._follows_velocity(train, place)
            try:
                chosen = point if command and not point.streamed else self._decide(axis, train, place)
            except NotJoined as error:
                result.refused.append(error)
                if follows_velocity or (train.drive is _Drive.VELOCITY and place.streaming):
                    result.stop.append(number)
                    axis.executed = None
                continue
            if chosen is None:
                axis.waiting = self._time, point
            else:
                result.points[number] = chosen
                if point.position is not None or point.velocity or point.effort:  # not a command to stand
                    axis.executed = point.streamed, self._time
                train.executed = True
                if train.same >= _HELD:
                    axis.barred = None
        return result

    def _next(self, number: int, point: JointSetPoint, stamp: float, *, released: bool) -> _Train:
        """Register a message of an axis and return its train."""
        axis = self._axes[number]
        axis.waiting = None if point.position is not None and not point.streamed else axis.waiting
        train = axis.trains.get(point.streamed)
        if train is None or self._time - train.time >= GAP:
            repeats = train is not None and train.point == point
            train = _Train(point, self._time, stamp, number in self._wrapping, repeats=repeats)
            train.find_origin()
            axis.trains[point.streamed] = train
        else:
            before = train.point
            if released and not axis.released:
                train.velocity_commanded = train.executed = False
                train.old = True
            train.before, train.elapsed = before, stamp - train.stamp
            train.point, train.time, train.stamp = point, self._time, stamp
            train.steps = train.steps + 1 if train.is_step() else 0
            if point.position == before.position:
                train.same += 1
                began = before.velocity == 0.0 or train.drive is _Drive.POSITION
                train.velocity_commanded |= began and bool(point.velocity) and point.velocity != before.velocity
                contradicts = bool(point.velocity) and not train.velocity_is_old
                train.contradictions = train.contradictions + 1 if contradicts else 0
            else:
                train.held, train.same, train.contradictions = train.same, 1, 0
                train.velocity_commanded = False
            train.find_origin()
        axis.released = released
        return train

    # ---- rules
    def _follows_velocity(self, train: _Train, place: Place) -> bool:
        """Whether a path follows a velocity or an effort, whose controller has ended then."""
        holder = place.holder
        expires = holder is not None and holder.topic == self._topic and holder.quantity in ("velocity", "effort")
        return expires and train.point.streamed and (train.before is None or train.drive is _Drive.VELOCITY)

    def _decide(self, axis: _Axis, train: _Train, place: Place) -> JointSetPoint | None:
        """Return what is executed of the newest message of a train; None: a position that may be isolated."""
        point = train.point
        if point.position is None:
            return self._expiring(train, place)
        if not point.streamed:
            return self._position(axis, train, place, point.position)
        if train.before is None:
            # The hardware interface is silent while commands and states agree; then a velocity controller commands.
            here = place.distance(point.position) <= _HERE and abs(place.velocity) <= JOIN_SPEED
            train.velocity_commanded = bool(point.velocity) and here and not train.repeats
        train.drive = _driven(train)
        if train.drive is _Drive.VELOCITY:
            if train.velocity_commanded:
                return JointSetPoint(velocity=point.velocity)
            raise self._refusal(
                place,
                "contradiction",
                f"the position is constant at {point.position:g} rad, but the velocity is {point.velocity:g} rad/s; "
                "which one is commanded is not known: send a velocity of 0 first",
            )
        if train.drive is _Drive.POSITION:
            follows = place.holder == Source(self._topic, "position")
            if follows or point.velocity or place.distance(point.position) > JOIN_DISTANCE:
                return self._position(axis, train, place, point.position)
        self._require_joining(axis, train, place, point.position)
        return point

    def _expiring(self, train: _Train, place: Place) -> JointSetPoint:
        """Velocity or effort alone."""
        point = train.point
        velocity = point.effort is None
        value = point.velocity if velocity else point.effort
        if train.before is None or place.holder is not None or not value:
            return point
        name, unit = ("velocity", "rad/s") if velocity else ("effort", "N m")
        raise self._refusal(
            place,
            "continues",
            f"the {name} is {value:g} {unit} since before the axes were enabled; it is accepted after one of 0, or "
            f"after a pause of {GAP:g} s",
        )

    def _position(self, axis: _Axis, train: _Train, place: Place, position: float) -> JointSetPoint | None:
        """Position alone, or of a message whose velocity is not used."""
        chosen = JointSetPoint(position)
        alone = train.before is None or train.before.position is None
        joined = train.executed and place.holder is not None and place.holder.topic == self._topic
        if joined and position != axis.barred:
            return chosen
        there = place.distance(position) <= JOIN_DISTANCE and abs(place.velocity) <= JOIN_SPEED
        there = there and not self._moved_by(axis, train, place)
        if alone:
            return chosen if there else None
        stepped = train.held >= _HELD and train.step > JOIN_DISTANCE
        if train.same == 1 and (there or (stepped and position != axis.barred)):
            return chosen
        axis.barred = position
        if place.holder is None and train.old and train.same > 1:
            raise self._refusal(
                place,
                "repeats",
                f"the position {position:g} rad repeats a set-point from before the axes were enabled; it is accepted "
                f"when it changes to a place of the joint, by a step, or alone; {_where(place, position)}",
            )
        raise self._refusal(
            place,
            "position",
            f"{_where(place, position)}; messages closer than {GAP:g} s must begin where the joint is, within "
            f"{JOIN_DISTANCE:g} rad: send a single message, or use {place.joint}/position",
        )

    def _require_joining(self, axis: _Axis, train: _Train, place: Place, position: float) -> None:
        """Check that a path joins its joint, or continues.

        Raises
        ------
        NotJoined
            If it does not.
        """
        velocity, before = train.point.velocity or 0.0, train.before
        joined = place.holder == Source(self._topic, "trajectory")
        if joined and place.streaming and train.executed and before is not None and before.position is not None:
            fastest = max(abs(velocity), abs(before.velocity or 0.0))
            if train.point.velocity is None:
                return
            if train.step <= JOIN_DISTANCE + fastest * (max(train.elapsed, 0.0) + RESUME_TIME):
                return
        ahead = abs(velocity) * (RESUME_TIME if joined else JOIN_TIME)
        if place.distance(position) > JOIN_DISTANCE + ahead:
            raise self._refusal(
                place,
                "stream",
                f"{_where(place, position)}; a stream begins within {JOIN_DISTANCE + ahead:.2g} rad of the joint: "
                f"start it from the measured position, for example by a new goal of the controller or by its "
                f"reactivation, or move the joint with {place.joint}/position",
            )
        if joined:
            return
        mover = self._moved_by(axis, train, place)
        if mover:
            raise self._refusal(
                place,
                "moved",
                f"{mover} moves the joint; the stream is accepted when it begins at the joint after that",
            )
        differs = abs(velocity - place.velocity) > JOIN_SPEED + 0.1 * abs(velocity)
        begun = train.origin is not None and place.distance(train.origin) <= JOIN_DISTANCE + ahead
        if differs and (not begun or abs(place.velocity) > JOIN_SPEED):
            raise self._refusal(
                place,
                "passes",
                f"the stream passes the joint with {velocity:g} rad/s, the joint has {place.velocity:.2g} rad/s; "
                "start it from the measured position",
            )

    def _moved_by(self, axis: _Axis, train: _Train, place: Place) -> str:
        """What moves the joint instead of this train; empty: nothing."""
        if place.moved_by or axis.executed is None:
            return place.moved_by
        form, time = axis.executed
        other = form is not train.point.streamed and place.holder is not None and self._time - time < SETTLING
        return f"another sender on {self._topic}" if other else ""

    def _refusal(self, place: Place, rule: str, reason: str) -> NotJoined:
        return NotJoined(f"{place.joint} {rule}", f"{self._topic}: {place.joint}: {reason}")


def _driven(train: _Train) -> _Drive:
    """Quantity that is executed of the newest message with position and velocity."""
    before, point = train.before, train.point
    if before is None or before.position is None or point.velocity is None or point.position is None:
        return _Drive.PATH
    if train.same > 1:
        if train.contradictions >= _CONTRADICTIONS:
            return _Drive.VELOCITY
        ended = train.drive is _Drive.VELOCITY and not train.velocity_commanded
        return _Drive.PATH if ended else train.drive
    stepped = train.steps > 1 or (train.steps == 1 and (bool(point.velocity) or train.step > JOIN_DISTANCE))
    return _Drive.POSITION if stepped else _Drive.PATH


def _distance(one: float, other: float, *, wraps: bool) -> float:
    return abs(math.remainder(one - other, math.tau) if wraps else one - other)


def _where(place: Place, position: float) -> str:
    distance = place.distance(position)
    return f"the joint is at {place.position:.4g} rad, {distance:.3g} rad from the set-point {position:.4g} rad"
