"""Motion that the commands of a user permit: how far and how fast each joint may move.

A *command* is what a user has asked for: a goal of a controller that is active, until it is reached, aborted, replaced
or cancelled; a value for a forward controller, until the next one; a path or a position on another topic of the bridge,
until its end or a stop. Nothing else is a command: neither the activation of hardware or controllers, nor ``enable``, a
restart or a reconnection, nor a message that a controller sends without one of these.

A joint without a command may stop from its present speed, and otherwise not move farther than `RESERVE` or faster than
`REST_SPEED`. With commands it may move within the range from its place to their targets, with their largest speed times
`SPEED_FACTOR`. The rotor search of ``enable`` may turn the motor by `SEARCH`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from servo_msgs_py.catalogue import AXES

RESERVE: Final = 0.08
"""Permitted distance from the permitted range [rad]: where a stream may join, and errors of the position control."""

REST_SPEED: Final = 2.0
"""Permitted speed without a command [rad/s]: a stream joins, the position controller settles."""

SPEED_FACTOR: Final = 1.6
"""Permitted speed relative to the commanded one: a stream makes up for its delay."""

OVERSHOOT: Final = 0.2
"""Permitted distance beyond the range of a path that replaces a motion: this times its duration, and `DELAY`, times the
largest speed of that motion."""

SPEED_LIMIT: Final = 80.0
"""Largest speed of a move that the board shapes, for `OVERSHOOT` [rad/s of the motor]."""

STOP_TIME: Final = 0.35
"""Permitted distance of a stop, as a time at the present speed [s]. Without outputs the default motors coast by
J / B (1 - c / (B w) ln(1 + B w / c)) times the speed w: at 113 rad/s 0.17 s for axis 1 and 0.31 s for axis 2."""

DELAY: Final = 0.25
"""Time until the end of a command takes effect [s]: delay of a stream, points in the queue of the board."""

TIMEOUT: Final = 0.5 + DELAY
"""The same for a velocity: the board runs on until ``param.command_timeout`` [s]."""

STOP_DELAY: Final = 0.05
"""Time until a stop takes effect [s]: messages in transit."""

SEARCH: Final = 0.8
"""Permitted distance of a rotor search [rad of the motor]."""

SEARCH_SPEED: Final = 40.0
"""Permitted speed of a rotor search [rad/s of the motor]."""


@dataclass(frozen=True)
class Motion:
    """State of all joints."""

    time: float  # [s]
    positions: tuple[float, ...]  # [rad]
    velocities: tuple[float, ...]  # [rad/s]


@dataclass
class Command:
    """A command to all joints."""

    targets: tuple[float, ...]  # [rad]; infinite: no end
    speeds: tuple[float, ...]  # largest ones [rad/s]
    valid: Callable[[], bool]  # whether it has not ended
    stopped: bool = True  # whether a stop of the bridge ends it
    duration: float = 0.0  # of its path [s]
    delay: float = DELAY  # until its end takes effect [s]
    reach: tuple[float, ...] = (0.0,) * AXES  # permitted distance beyond its targets [rad]
    axes: set[int] = field(default_factory=lambda: set(range(AXES)))  # joints that it still moves
    until: float = math.inf  # end of its effect [s]


@dataclass(frozen=True)
class Violation:
    """A motion that was not permitted."""

    time: float  # [s]
    axis: int
    text: str  # motion and permission


class Permission:
    """Permitted motion of all joints.

    Parameters
    ----------
    limits : sequence of (float, float)
        Lowest and highest position of each joint [rad].
    ratios : sequence of float
        Turns of the motor per turn of each joint.
    """

    def __init__(self, limits: Sequence[tuple[float, float]], ratios: Sequence[float]) -> None:
        self.commands: list[Command] = []  # whose effect has not ended
        self.violations: list[Violation] = []  # the first one of each joint
        self._limits, self._ratios = limits, ratios
        self._ranges = [(-math.inf, math.inf)] * AXES  # permitted positions [rad]
        self._bounds = list(limits)  # limits that hold now: a joint outside may return [rad]
        self._speeds = [math.inf] * AXES  # permitted speeds [rad/s]
        self._coasting: set[int] = set()  # joints whose outputs a fault has switched off, since the last ``enable``

    def renew(self, motion: Motion, *, search: bool = False) -> None:
        """Begin again at a state: permit a stop there, the commands that are valid, and the rotor search, if any."""
        if search:
            self._coasting.clear()
        for axis, (position, velocity) in enumerate(zip(motion.positions, motion.velocities, strict=True)):
            speed = abs(velocity)
            reach = speed * STOP_TIME + (SEARCH / self._ratios[axis] if search else 0.0)
            speeds = [1.1 * speed, REST_SPEED, *([SEARCH_SPEED / self._ratios[axis]] if search else [])]
            low, high = position - reach, position + reach
            for command in self.commands:
                if axis not in command.axes:
                    continue
                ends = position, command.targets[axis]
                low, high = min(low, min(ends) - command.reach[axis]), max(high, max(ends) + command.reach[axis])
                speeds.append(SPEED_FACTOR * command.speeds[axis] + REST_SPEED)
            self._ranges[axis], self._speeds[axis] = (low, high), max(speeds)
            lowest, highest = self._limits[axis]
            way = speed * STOP_TIME if axis in self._coasting else 0.0
            self._bounds[axis] = min(lowest, position - way), max(highest, position + way)

    def begin(self, command: Command, motion: Motion) -> None:
        """Permit a command, in addition to the valid ones."""
        command.reach = tuple(
            (OVERSHOOT * command.duration + DELAY) * max(abs(velocity), self._commanded(axis))
            for axis, velocity in enumerate(motion.velocities)
        )
        self.commands.append(command)
        self.renew(motion)

    def _commanded(self, axis: int) -> float:
        """Largest commanded speed of a joint [rad/s]."""
        speeds = [command.speeds[axis] for command in self.commands if axis in command.axes]
        return min(max(speeds, default=0.0), SPEED_LIMIT / self._ratios[axis])

    def fault(self, motion: Motion, axes: Collection[int]) -> None:
        """Switch off the outputs of joints: they coast, also beyond their limits."""
        self._coasting |= set(axes)
        self.stop(motion, axes)

    def stop(self, motion: Motion, axes: Collection[int] = range(AXES), delay: float = STOP_DELAY) -> None:
        """Stop joints; ends the commands that a stop ends, after the delay [s]."""
        for command in [command for command in self.commands if command.stopped]:
            rest = command.axes - set(axes)
            if rest:
                self.commands.append(replace(command, axes=rest))
            command.axes -= rest
            command.until = min(command.until, motion.time + delay)
        self.renew(motion)

    def update(self, motion: Motion) -> None:
        """End the commands that are not valid any more: permit a stop from the speed at this time; call it often."""
        ended = [command for command in self.commands if command.until == math.inf and not command.valid()]
        for command in ended:
            command.until = motion.time + command.delay
        left = [command for command in self.commands if motion.time < command.until]
        if ended or len(left) < len(self.commands):
            self.commands = left
            self.renew(motion)

    def check(self, motion: Motion) -> None:
        """Record a violation."""
        for axis, (position, velocity) in enumerate(zip(motion.positions, motion.velocities, strict=True)):
            (low, high), (lowest, highest) = self._ranges[axis], self._bounds[axis]
            beyond = max(low - position, position - high)
            text = ""
            if not lowest - RESERVE <= position <= highest + RESERVE:
                text = f"at {position:.3f} rad, outside its limits {lowest:.3f} .. {highest:.3f} rad"
            elif beyond > RESERVE:
                text = f"at {position:.3f} rad, {beyond:.3f} rad outside {low:.3f} .. {high:.3f} rad"
            elif abs(velocity) > self._speeds[axis]:
                text = f"moves at {velocity:.2f} rad/s, {self._speeds[axis]:.2f} rad/s are permitted"
            if text and all(each.axis != axis for each in self.violations):
                self.violations.append(Violation(motion.time, axis, text))
