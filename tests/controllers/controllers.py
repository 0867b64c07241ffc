"""Controllers: joint_trajectory_controller and the forward controllers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from controllers.hardware import POSITION, VELOCITY, TopicHardware
from controllers.trajectory import Point, Trajectory, shortest_distance

SUCCESSFUL: Final = 0
INVALID_GOAL: Final = -1
PATH_TOLERANCE_VIOLATED: Final = -4
GOAL_TOLERANCE_VIOLATED: Final = -5
CANCELED: Final = 1
"""A cancelled goal has the code 0; another number distinguishes it here."""


class Controller(Protocol):
    """A controller of a manager."""

    active: bool

    def activate(self, hardware: TopicHardware) -> None:
        """Claim the interfaces."""

    def deactivate(self) -> None:
        """Release the interfaces."""

    def update(self, time: float) -> None:
        """Calculate the commands of a cycle at a time [s]."""


@dataclass(frozen=True)
class Constraints:
    """Parameters ``constraints`` of a joint_trajectory_controller; the same for all joints."""

    trajectory: float = 0.0  # largest distance from the reference before the end [rad]; 0: any
    goal: float = 0.0  # largest distance from the end [rad]; 0: any
    goal_time: float = 0.0  # time after the end in which the joints must be there [s]; 0: for ever
    stopped_velocity_tolerance: float = 0.01  # largest speed at the end [rad/s]; 0: any


class JointTrajectoryController:
    """joint_trajectory_controller with position and velocity commands.

    Parameters
    ----------
    joints : sequence of str
        Its joints.
    rate : float
        Update rate [Hz].
    interpolate_from_desired_state : bool
        True: a new trajectory begins at the last command; False: at the measured state.
    continuous : sequence of str
        Joints of the type ``continuous`` in the robot description.
    constraints : Constraints, optional
        Tolerances; by default those of the parameters.
    last_command_on_activation : bool
        Parameter ``set_last_command_interface_value_as_state_on_activation``.
    """

    def __init__(
        self,
        joints: Sequence[str],
        rate: float,
        *,
        interpolate_from_desired_state: bool = False,
        continuous: Sequence[str] = (),
        constraints: Constraints | None = None,
        last_command_on_activation: bool = True,
    ) -> None:
        self.active = False
        self.results: list[int] = []  # codes of the finished goals
        self.reference: Point | None = None  # last command
        self._joints = tuple(joints)
        self._period = 1.0 / rate
        self._open_loop = interpolate_from_desired_state
        self._continuous = [joint in continuous for joint in joints]
        self._constraints = constraints or Constraints()
        self._last_command_on_activation = last_command_on_activation
        self._goal = False  # whether a goal is executed
        self._holding = True  # whether the trajectory is a hold, without tolerances
        self._new: Trajectory | None = None  # of the next cycle
        self._current: Trajectory | None = None  # of the last cycle

    # ---- goals
    @property
    def executes_goal(self) -> bool:
        """Whether a goal is neither finished nor cancelled."""
        return self._goal

    def goal(self, targets: Mapping[str, Sequence[Point]] | Sequence[Point]) -> bool:
        """Accept a goal for all joints, or, by joint, for some of them; False: rejected."""
        if not self.active:
            return False
        if self._goal:
            self._finish(INVALID_GOAL)
        self._new = Trajectory(self._filled(targets) if isinstance(targets, Mapping) else targets)
        self._goal, self._holding = True, False
        return True

    def cancel(self) -> None:
        """Cancel the goal: hold the measured position."""
        if self._goal:
            self._finish(CANCELED)
            self._hold_measured()

    def _filled(self, targets: Mapping[str, Sequence[Point]]) -> list[Point]:
        """Points of all joints; joints without points hold their command."""
        held = {joint: self._hardware.commands[joint, POSITION] for joint in self._joints}
        result = []
        for points in zip(*targets.values(), strict=True):
            given = dict(zip(targets, points, strict=True))
            result.append(
                Point(
                    tuple(given[joint].positions[0] if joint in given else held[joint] for joint in self._joints),
                    self._column("velocities", given),
                    self._column("accelerations", given),
                    points[0].time,
                )
            )
        return result

    def _column(self, name: str, given: Mapping[str, Point]) -> tuple[float, ...]:
        """Derivatives of all joints, 0 for those without points; empty if the points have none."""
        values = {joint: getattr(point, name) for joint, point in given.items()}
        if not all(values.values()):
            return ()
        return tuple(values[joint][0] if joint in values else 0.0 for joint in self._joints)

    # ---- life
    def activate(self, hardware: TopicHardware) -> None:
        """Hold the commanded positions, or, if there are none, the measured ones."""
        self.active = True
        self._hardware = hardware
        self._measured = self._read()
        if self._last_command_on_activation:
            self._measured = self._with_commands(self._measured)
        self._last = self._measured
        self._last_time: float | None = None
        self._current = None
        self._time = 0.0
        self._desired = self._measured
        self._hold_measured()

    def deactivate(self) -> None:
        """Abort the goal; the commands keep their positions, and velocities become 0."""
        if self._goal:
            self._finish(INVALID_GOAL)
        for joint in self._joints:
            if (joint, VELOCITY) in self._hardware.commands:
                self._hardware.commands[joint, VELOCITY] = 0.0
        self.active = False

    # ---- cycle
    def update(self, time: float) -> None:
        """Calculate the commands, one period ahead; check the tolerances."""
        current, first = self._new, self._new is not self._current
        self._current = current
        assert current is not None
        self._measured = self._read()
        if first:
            self._time = time
            if self._open_loop:
                current.set_start(time if self._last_time is None else self._last_time, self._last, self._continuous)
            else:
                current.set_start(time, self._measured, self._continuous)
        else:
            self._time += self._period
        desired = current.sample(self._time)
        following = current.sample(self._time + self._period)
        if desired is not None:
            self._desired = desired.state
        if following is None or current.start is None:
            return
        since_reached = self._time - current.start - following.reached
        constraints = self._constraints
        violated = outside = False
        for k in range(len(self._joints)):
            error, speed_error = self.error(k)
            if (not following.finished or first) and not self._holding:
                violated |= 0.0 < constraints.trajectory < abs(error)
            if following.finished and not self._holding:
                outside |= 0.0 < constraints.goal < abs(error)
                outside |= 0.0 < constraints.stopped_velocity_tolerance < abs(speed_error)
        late = outside and 0.0 < constraints.goal_time < since_reached
        if not violated and not late:
            self._command(following.state)
            self._last, self._last_time = following.state, time
        self._conclude(violated, following.finished, outside, late)

    def error(self, k: int) -> tuple[float, float]:
        """Errors of position [rad] and velocity [rad/s] of a joint, as the controller sees them."""
        actual, desired = self._measured.positions[k], self._desired.positions[k]
        error = shortest_distance(actual, desired) if self._continuous[k] else desired - actual
        return error, self._desired.velocities[k] - self._measured.velocities[k]

    def _conclude(self, violated: bool, finished: bool, outside: bool, late: bool) -> None:
        if violated:
            if self._goal:
                self._finish(PATH_TOLERANCE_VIOLATED)
            self._hold_measured()
        elif finished and self._goal and not outside:
            assert self._current is not None
            self._finish(SUCCESSFUL)
            last = self._current.points[-1]
            self._new = Trajectory([Point(last.positions, last.velocities, last.accelerations)])
            self._holding = True
        elif late:
            if self._goal:
                self._finish(GOAL_TOLERANCE_VIOLATED)
            self._hold_measured()

    def _hold_measured(self) -> None:
        self._new = Trajectory([Point(self._measured.positions, (0.0,) * len(self._joints))])
        self._holding = True

    def _finish(self, code: int) -> None:
        self._goal = False
        self.results.append(code)

    def _read(self) -> Point:
        states = self._hardware.states
        positions, velocities = (tuple(states[joint, kind] for joint in self._joints) for kind in (POSITION, VELOCITY))
        return Point(positions, velocities)

    def _with_commands(self, state: Point) -> Point:
        """State with the commands of each interface that has been written for all joints."""
        return Point(self._written(POSITION, state.positions), self._written(VELOCITY, state.velocities))

    def _written(self, kind: str, measured: tuple[float, ...]) -> tuple[float, ...]:
        values = tuple(self._hardware.commands.get((joint, kind), math.nan) for joint in self._joints)
        return measured if any(map(math.isnan, values)) else values

    def _command(self, state: Point) -> None:
        self.reference = state
        for k, joint in enumerate(self._joints):
            for kind, values in ((POSITION, state.positions), (VELOCITY, state.velocities)):
                if (joint, kind) in self._hardware.commands:
                    self._hardware.commands[joint, kind] = values[k]


class ForwardController:
    """forward_position_controller or forward_velocity_controller.

    Parameters
    ----------
    joints : sequence of str
        Its joints.
    interface : str
        Interface that it commands.
    """

    def __init__(self, joints: Sequence[str], interface: str) -> None:
        self.active = False
        self.interface = interface
        self._joints = tuple(joints)
        self.values: tuple[float, ...] | None = None  # last command since the activation

    def command(self, values: Sequence[float]) -> None:
        """Command all joints from the next cycle on."""
        if self.active:
            self.values = tuple(values)

    def activate(self, hardware: TopicHardware) -> None:
        """Write nothing before the first command."""
        self.active = True
        self._hardware = hardware
        self.values = None

    def deactivate(self) -> None:
        """Leave the last command in the interfaces."""
        self.active = False
        self.values = None

    def update(self, time: float) -> None:
        """Write the last command."""
        del time
        for joint, value in zip(self._joints, self.values or (), strict=False):
            self._hardware.commands[joint, self.interface] = value
