"""Sequences of commands of a user and of ros2_control to the bridge, in simulated time.

A sequence runs on the real bridge and firmware (`simulated_bridge`), with the model of ros2_control (`controllers`) at
the other end. `motion_permission` decides from the commands alone whether the motion of the shafts is permitted.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, Literal

from builtin_interfaces.msg import Duration, Time
from controllers.controllers import Constraints, Controller, ForwardController, JointTrajectoryController
from controllers.hardware import (
    CURRENT_PLUGIN,
    OLD_PLUGIN,
    POSITION,
    VELOCITY,
    CommandMessage,
    StateMessage,
    TopicHardware,
)
from controllers.manager import ControllerManager
from controllers.trajectory import Point
from motion_permission import DELAY, TIMEOUT, Command, Motion, Permission, Violation
from sensor_msgs.msg import JointState
from servo_bridge.telemetry import rate_for_controllers
from servo_msgs_py.catalogue import AXES
from servo_msgs_py.joints import Joint
from servo_twin.fault_injection import HotPowerStage
from simulated_bridge import WALL_NS, BridgeSimulation
from std_msgs.msg import Float64, Header
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from servo_msgs_py import topics

EVENTS: Final = (
    "enable",
    "disable",
    "quick stop",
    "fault",
    "board restart",
    "bridge restart",
    "activate",
    "deactivate",
    "goal",
    "cancel",
    "move",
    "stall",
)

_JOINTS: Final = ("axis1", "axis2")

_TRANSPORT_NS: Final = 300_000
"""Time of a message from node to node [ns]."""

_POLL: Final = 0.02
"""Interval at which the motion is checked [s]."""

_HOT, _COLD, _FAULT_POLLS = 150.0, 25.0, 40
"""Temperatures of a power stage with and without a fault [deg C], and attempts to see it, 5 ms apart."""

_START: Final = 0.5
"""Time to start a controller_manager, less than a real one takes [s]."""

_ENABLE_MAX: Final = 2.5
"""Longest time of an enable [s]."""

_REPETITION: Final = 1.5
"""Observation after the last event [s]."""

LIMIT: Final = 3.0
"""Largest distance of limited joints from 0 [rad]."""

GOAL_ERROR: Final = 0.03
"""Largest distance from a goal at its end [rad]."""

Tolerances = Literal["shipped", "path", "none"]

_CONSTRAINTS: Final = {
    "shipped": Constraints(42.0, 0.02, 0.5, 0.5),  # of ros2_controllers.yaml
    "path": Constraints(0.5, 0.02, 0.5, 0.5),
    "none": Constraints(),
}

Kind = Literal["trajectory", "position", "velocity", ""]
"""A controller; empty: none."""


@dataclass(frozen=True)
class Setup:
    """Both ends of the topics."""

    rate: float = 100.0  # update_rate [Hz]
    jitter: float = 0.0  # largest additional delay of a command [s]
    old_plugin: bool = False  # topic_based_ros2_control 0.3
    interpolate_from_desired_state: bool = False  # of the joint_trajectory_controller
    last_command_on_activation: bool = False  # of the joint_trajectory_controller
    tolerances: Tolerances = "shipped"  # of the joint_trajectory_controller
    joints: Literal["turns", "limited", "angles"] = "turns"  # angles: they wrap, `continuous` in the robot description
    baud: int = 1_000_000  # [bit/s]
    gear_ratio: float = 1.0  # of both joints
    direction: int = 1  # of both joints
    running: bool = True  # begin enabled, with joints that a goal has moved
    preferred_source: str = ""  # parameter of the bridge
    separate: bool = False  # each joint has controllers of its own


@dataclass(frozen=True)
class Step:
    """An event of a sequence."""

    event: str  # of `EVENTS`, or "stranger"
    pause: float = 0.7  # until the next event [s]
    controller: Kind = "trajectory"  # activate, deactivate: the controller; empty: only the hardware
    second: Kind = "trajectory"  # activate: the controller of the second joint, if it has its own
    hardware: bool = True  # deactivate: also the hardware, else it goes on sending
    restart: bool = False  # activate: in a new process of the controller_manager
    setup: Setup | None = None  # of this process; None: that of the sequence
    distance: float = 1.0  # goal, move: from the place of the joint [rad]; the second joint moves the other way
    time: float = 0.6  # goal, move, stall [s]
    velocities: bool = False  # goal: with velocity 0 at its end
    topic: Literal["path", "position"] = "path"  # move: a path, or a position of each joint


SETUP_VALUES: Final[Mapping[str, Sequence[Any]]] = {
    "rate": (100.0, 50.0, 500.0),
    "jitter": (0.0, 0.005),
    "old_plugin": (False, True),
    "interpolate_from_desired_state": (False, True),
    "last_command_on_activation": (False, True),
    "tolerances": ("shipped", "path", "none"),
    "joints": ("turns", "turns", "limited", "angles"),
    "baud": (1_000_000, 115_200),
    "gear_ratio": (1.0, 3.0),
    "direction": (1, -1),
    "running": (True, True, False),
    "separate": (False, False, True),
}
"""Values of a `Setup`, the simplest first."""

STEP_VALUES: Final[Mapping[str, Sequence[Any]]] = {
    "pause": (0.7, 0.1, 0.3, 1.3),
    "controller": ("trajectory", "", "position", "velocity"),
    "restart": (False, False, True),
    "distance": (1.0, -0.5, 3.0, -2.0),
    "time": (0.6, 0.4, 1.2),
    "velocities": (False, True),
    "topic": ("path", "position"),
    "second": ("trajectory", "position", "velocity"),
    "hardware": (True, True, False),
}
"""Values of a `Step` without its event, the simplest first."""


@dataclass
class _Group:
    """Controllers of the same joints, of which one is active at a time."""

    axes: tuple[int, ...]
    trajectory: JointTrajectoryController
    forward: dict[str, ForwardController]  # by interface
    active: Kind = ""

    @staticmethod
    def of(setup: Setup, axes: tuple[int, ...]) -> _Group:
        """Return the inactive controllers of some axes."""
        joints = [_JOINTS[axis] for axis in axes]
        trajectory = JointTrajectoryController(
            joints,
            setup.rate,
            interpolate_from_desired_state=setup.interpolate_from_desired_state,
            continuous=joints if setup.joints == "angles" else (),
            constraints=_CONSTRAINTS[setup.tolerances],
            last_command_on_activation=setup.last_command_on_activation,
        )
        return _Group(axes, trajectory, {name: ForwardController(joints, name) for name in (POSITION, VELOCITY)})

    @property
    def controllers(self) -> dict[str, Controller]:
        """All controllers, by kind."""
        return {"trajectory": self.trajectory, **self.forward}

    def of_axes(self, values: Sequence[float]) -> tuple[float, ...]:
        """Values of its axes, of those of all axes."""
        return tuple(values[axis] for axis in self.axes)


class CommandSequence:
    """Runs a sequence.

    Parameters
    ----------
    setup : Setup
        Both ends.
    steps : sequence of Step
        The events.
    """

    def __init__(self, setup: Setup, steps: Sequence[Step]) -> None:
        self._setup, self._steps = setup, steps
        self._random = random.Random(7)
        self._arrival_ns = 0  # of the newest command
        parameters: dict[str, Any] = {
            "telemetry_rate": rate_for_controllers(setup.rate),
            "gear_ratio": [setup.gear_ratio] * AXES,
            "direction": [setup.direction] * AXES,
            "wraps": [setup.joints == "angles"] * AXES,
            "preferred_source": setup.preferred_source,
        }
        limit = LIMIT if setup.joints == "limited" else math.inf
        if setup.joints == "limited":
            parameters |= {"position_min": [-limit] * AXES, "position_max": [limit] * AXES}
        self.sim = BridgeSimulation(baud=setup.baud, **parameters)
        self._world = self.sim.world
        self._joints = [
            Joint(name, setup.gear_ratio, setup.direction, wraps=setup.joints == "angles") for name in _JOINTS
        ]
        self._permission = Permission([(-limit, limit)] * AXES, [setup.gear_ratio] * AXES)
        self.speed_max = 0.0  # of a joint [rad/s]
        self.places: list[tuple[float, ...]] = []  # of the joints at the begin of each step, and at the end [rad]
        self.results: list[int] = []  # of the goals of the last trajectory controller before the recovery
        self._checked = 0  # rows of the log
        self._epoch = -1
        self._origins: tuple[float, ...] = (0.0,) * AXES  # angle of each motor at its position 0 [rad]
        self._process = 0  # number of the process of the controller_manager
        self._new_manager(setup)
        self.sim.listeners[topics.JOINT_STATES] = self._on_states

    def run(self) -> list[Violation]:
        """Run the sequence; returns the first violation of each joint."""
        with self.sim:
            self.sim.run(self._script())
        return self._permission.violations

    @property
    def log(self) -> list[str]:
        """Log of the last process of the bridge."""
        return [f"{time:.3f} {level}: {text}" for time, level, text in self.sim.node.logger.lines]

    # ---- ros2_control
    def _new_manager(self, setup: Setup) -> None:
        self.hardware = TopicHardware(
            _JOINTS,
            dict.fromkeys(_JOINTS, (POSITION, VELOCITY)),
            OLD_PLUGIN if setup.old_plugin else CURRENT_PLUGIN,
        )
        self._groups = [_Group.of(setup, axes) for axes in ([(0,), (1,)] if setup.separate else [(0, 1)])]
        self.trajectory = self._groups[0].trajectory
        controllers = [each for group in self._groups for each in group.controllers.values()]
        self._manager = ControllerManager(self.hardware, controllers, setup.rate)
        self._process += 1

    def _on_states(self, message: JointState) -> None:
        state = StateMessage(tuple(message.name), tuple(message.position), tuple(message.velocity))
        self._world.at(self._world.now_ns + _TRANSPORT_NS, lambda: self.hardware.receive(state))

    def _cycle(self, process: int) -> None:
        if process != self._process:
            return
        now = self._world.now_ns
        self._world.at(now + round(1e9 / self._setup.rate), partial(self._cycle, process))
        message = self._manager.cycle(now * 1e-9)
        if message is not None:
            command = joint_state(message, now + WALL_NS)
            arrival = now + _TRANSPORT_NS + round(self._random.random() * self._setup.jitter * 1e9)
            self._arrival_ns = max(arrival, self._arrival_ns)  # in order
            self._world.at(self._arrival_ns, partial(self._publish, topics.JOINT_COMMANDS, command))

    def _publish(self, topic: str, message: object) -> None:
        self.sim.node.send(topic, message)

    # ---- motion
    def _motion(self, time: float, theta: Sequence[float], omega: Sequence[float]) -> Motion:
        return Motion(
            time,
            tuple(j.position(t - o) for j, t, o in zip(self._joints, theta, self._origins, strict=True)),
            tuple(j.velocity(w) for j, w in zip(self._joints, omega, strict=True)),
        )

    def _now(self) -> Motion:
        """Check the log since the last call, and return the present state."""
        theta, omega = self._world.shafts()
        if self._world.epoch != self._epoch:
            self._epoch, self._origins = self._world.epoch, theta
        for row in self._world.log[self._checked :]:
            if row.epoch == self._epoch:
                motion = self._motion(row.time, row.theta, row.omega)
                self.speed_max = max(self.speed_max, *map(abs, motion.velocities))
                self._permission.check(motion)
        self._checked = len(self._world.log)
        return self._motion(self.sim.now, theta, omega)

    def _wait(self, seconds: float) -> Iterator[float]:
        end = self.sim.now + seconds
        while self.sim.now < end - 1e-9:
            yield min(_POLL, end - self.sim.now)
            self._permission.update(self._now())

    def _begin(self, command: Command) -> None:
        self._permission.begin(command, self._now())

    # ---- script
    def _script(self) -> Iterator[float]:
        self._permission.renew(self._now())
        yield from self._wait(0.3 if self._setup.baud > 200_000 else 0.8)
        if self._setup.running:
            first = (
                Step("activate", 0.1),
                Step("enable", 0.2),
                Step("goal", 1.2, distance=1.3, time=0.5, velocities=True),
            )
            yield from self._events(first)
        for step in self._steps:
            self.places.append(self._now().positions)
            yield from self._events((step,))
        self.places.append(self._now().positions)
        yield from self._wait(_REPETITION)
        self.results = list(self.trajectory.results)
        yield from self._recover()

    def _recover(self) -> Iterator[float]:
        """A user who enables, starts a controller and sends a goal must reach it."""
        shipped = replace(
            self._setup,
            interpolate_from_desired_state=False,
            last_command_on_activation=False,
            tolerances="shipped",
            separate=False,
        )
        yield from self._events((Step("activate", 0.1, restart=True, setup=shipped), Step("enable", 0.3)))
        place = self._now().positions
        inwards = 0.5 if place[0] < place[1] else -0.5  # towards the middle of the range
        yield from self._events((Step("goal", 1.2, distance=inwards, time=0.5, velocities=True),))
        moved = [now - before for now, before in zip(self._now().positions, place, strict=True)]
        if abs(moved[0] - inwards) > GOAL_ERROR or abs(moved[1] + inwards) > GOAL_ERROR:
            text = f"the last goal was not reached: moved {moved[0]:.3f} and {moved[1]:.3f} rad of {inwards} rad"
            self._permission.violations.append(Violation(self.sim.now, 0, text))

    def _events(self, steps: Sequence[Step]) -> Iterator[float]:
        for step in steps:
            self._now()
            yield from getattr(self, f"_{step.event.replace(' ', '_')}")(step)
            yield from self._wait(step.pause)

    def _enable(self, _: Step) -> Iterator[float]:
        node = self.sim.node
        node.call(topics.CLEAR_FAULTS, Trigger, Trigger.Request())
        yield from self._wait(0.05)
        self._permission.renew(self._now(), search=True)
        answer = node.call(topics.ENABLE, SetBool, SetBool.Request(data=True))
        end = self.sim.now + _ENABLE_MAX
        while not answer.done() and self.sim.now < end:
            yield 0.01
        self._permission.renew(self._now())

    def _disable(self, _: Step) -> Iterator[float]:
        yield from self._stop(topics.ENABLE, SetBool, SetBool.Request(data=False))

    def _quick_stop(self, _: Step) -> Iterator[float]:
        yield from self._stop(topics.QUICK_STOP, Trigger, Trigger.Request())

    def _stop(self, name: str, kind: type, request: object) -> Iterator[float]:
        self.sim.node.call(name, kind, request)
        yield 0.0
        self._permission.stop(self._now())

    def _fault(self, _: Step) -> Iterator[float]:
        board = self._world.board
        board.inject(HotPowerStage(0, _HOT))
        for _attempt in range(_FAULT_POLLS):
            yield 0.005
            if board.read_words("axis1.faults") != [0]:
                self._permission.fault(self._now(), [0])
                break
        board.inject(HotPowerStage(0, _COLD))

    def _stall(self, step: Step) -> Iterator[float]:
        """The computer receives nothing for `Step.time`."""
        self._world.stall(step.time)
        yield 0.0

    def _stranger(self, step: Step) -> Iterator[float]:
        """Somebody moves the first joint, without a command of the user."""
        yield 0.0
        self._publish(topics.joint_position_topic(_JOINTS[0]), Float64(data=self._targets(step, 1.0)[0]))

    def _board_restart(self, _: Step) -> Iterator[float]:
        self._world.restart_board()
        yield 0.0
        self._permission.stop(self._now())

    def _bridge_restart(self, _: Step) -> Iterator[float]:
        self.sim.kill_bridge()
        self.sim.start_bridge()
        self._permission.stop(self._now(), delay=DELAY)
        yield 0.05

    def _activate(self, step: Step) -> Iterator[float]:
        if step.restart:
            self._process += 1  # ends the old process
            yield from self._wait(_START)
            self._new_manager(step.setup or self._setup)
        if step.restart or self._process == 1:
            self._process += 1
            self._cycle(self._process)
        self._manager.set_hardware_active(True)
        self._permission.renew(self._now())
        yield from self._wait(0.05)
        known = not any(map(math.isnan, self.hardware.states.values()))
        for group in self._groups:
            wanted = step.controller if 0 in group.axes else step.second
            if step.controller and wanted != group.active and known:
                stopped = group.controllers.get(group.active)
                group.active = wanted
                self._manager.switch(start=group.controllers[wanted], stop=stopped)

    def _deactivate(self, step: Step) -> Iterator[float]:
        for group in self._groups:
            if step.controller and group.active:
                self._manager.switch(stop=group.controllers[group.active])
                group.active = ""
        self._manager.set_hardware_active(not step.hardware)
        yield 0.0
        self._permission.renew(self._now())

    def _goal(self, step: Step) -> Iterator[float]:
        yield 0.0
        targets, speed = self._targets(step, 1.0), abs(step.distance) / step.time
        for group in self._groups:
            if group.active == "trajectory":
                velocities = (0.0,) * len(group.axes) if step.velocities else ()
                group.trajectory.goal([Point(group.of_axes(self._reported(targets)), velocities, (), step.time)])
                valid = partial(self._executes_goal, self._process, group)
                speeds = (1.5 * speed,) * AXES
                axes = set(group.axes)
                self._begin(Command(targets, speeds, valid, stopped=False, duration=step.time, axes=axes))
            elif group.active:
                self._forward(group, step, targets)

    def _forward(self, group: _Group, step: Step, targets: tuple[float, ...]) -> None:
        controller = group.forward[group.active]
        if controller.interface == POSITION:
            values, ends, speed, delay = self._reported(targets), targets, math.inf, DELAY
        else:
            speed, delay = step.distance / step.time, TIMEOUT
            values, ends = (speed, -speed), (math.copysign(math.inf, speed), -math.copysign(math.inf, speed))
        controller.command(group.of_axes(values))
        valid = partial(self._forwarded, self._process, group, controller, group.of_axes(values))
        self._begin(Command(ends, (abs(speed),) * AXES, valid, delay=delay, axes=set(group.axes)))

    def _executes_goal(self, process: int, group: _Group) -> bool:
        return process == self._process and group.trajectory.executes_goal

    def _forwarded(self, process: int, group: _Group, controller: ForwardController, values: tuple[float, ...]) -> bool:
        if process != self._process or not self.hardware.active:
            return False
        return controller.values == values or (controller.interface == VELOCITY and self._left_behind(group, values))

    def _left_behind(self, group: _Group, velocities: tuple[float, ...]) -> bool:
        """Whether the hardware goes on sending the velocities of a controller that has ended, and nothing else."""
        sent = tuple(self.hardware.commands[_JOINTS[axis], VELOCITY] for axis in group.axes)
        return sent == velocities and all(controller.values is None for controller in group.forward.values())

    def _cancel(self, _: Step) -> Iterator[float]:
        yield 0.0
        for group in self._groups:
            group.trajectory.cancel()

    def _move(self, step: Step) -> Iterator[float]:
        yield 0.0
        targets = self._targets(step, -1.0)
        end = self.sim.now + step.time + 1.0
        speed = math.inf if step.topic == "position" else 2.0 * abs(step.distance) / step.time
        self._begin(Command(targets, (speed,) * AXES, lambda: self.sim.now < end, duration=step.time))
        if step.topic == "position":
            for joint, target in zip(_JOINTS, self._reported(targets), strict=True):
                self._publish(topics.joint_position_topic(joint), Float64(data=target))
            return
        whole, part = divmod(round(step.time * 1e9), 1_000_000_000)
        point = JointTrajectoryPoint(
            positions=self._reported(targets),
            velocities=[0.0] * AXES,
            accelerations=[0.0] * AXES,
            time_from_start=Duration(sec=whole, nanosec=part),
        )
        self._publish(topics.JOINT_TRAJECTORY, JointTrajectory(joint_names=list(_JOINTS), points=[point]))

    def _reported(self, positions: Sequence[float]) -> tuple[float, ...]:
        return tuple(joint.reported(position) for joint, position in zip(self._joints, positions, strict=True))

    def _targets(self, step: Step, sign: float) -> tuple[float, ...]:
        first, second = self._now().positions
        return first + sign * step.distance, second - sign * step.distance


def joint_state(message: CommandMessage, stamp_ns: int) -> JointState:
    """ROS message of a message of the hardware, with the time of its sender [ns]."""
    second, nanosecond = divmod(stamp_ns, 1_000_000_000)
    return JointState(
        header=Header(stamp=Time(sec=second, nanosec=nanosecond)),
        name=list(message.names),
        position=list(message.positions),
        velocity=list(message.velocities),
    )
