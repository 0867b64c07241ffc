"""Motions of ``servo-command``: each ends where it was commanded, or with the reason why not.

Whatever ends the program during a motion (a signal, an error of its own), the joints are stopped before. A program that
is killed cannot do that: then the board ends velocities and efforts, and the bridge paths, see
`servo_msgs_py.answers`.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Final

from sensor_msgs.msg import JointState
from servo_msgs_py.answers import LEASE_TIMEOUT, Phase
from servo_msgs_py.convert import applied_from_message, from_stamp
from servo_msgs_py.joints import Joint
from servo_msgs_py.runtime.program import complain
from servo_msgs_py.runtime.qos import telemetry_qos
from std_msgs.msg import Int64MultiArray
from trajectory_msgs.msg import JointTrajectory

from servo_bridge.client import CommandError
from servo_bridge.commander import Commander
from servo_msgs_py import topics

POSITION_TOLERANCE: Final = 0.02  # largest distance from a commanded position that counts as reached [rad]
_HELD: Final = 0.1  # time within the tolerance until a position counts as reached [s]
_VELOCITY_TOLERANCE: Final = (0.05, 0.5)  # of a velocity: relative, and [rad/s]; the larger one counts
_MEAN: Final = 0.2  # time over which a velocity is averaged [s]
_STANDSTILL: Final = 2.0  # time without motion after which a position is not reached any more [s]
_STILL: Final = 1.0e-3  # largest motion of a joint at rest [rad]
_REPEAT: Final = 0.05  # period of velocity and effort set-points, which expire otherwise [s]
_CLOCK_SET: Final = 0.5  # jump of the stamps against the steady clock by which the system clock was set [s]
_SILENCE: Final = 3.0  # longest time without telemetry [s]
_VARIABLES: Final = {"position": "cmd.position", "velocity": "cmd.speed", "effort": "cmd.i_q"}


class Motions:
    """Motions of the joints of one servo.

    Parameters
    ----------
    commander : Commander
        The servo.
    """

    def __init__(self, commander: Commander) -> None:
        self._commander = commander
        self._commands = commander.commands
        self._samples: deque[tuple[float, JointState]] = deque(maxlen=4000)  # with their board time [s]
        self._set = 0.0  # by which the system clock was set meanwhile [s]
        self._received = 0.0  # steady time of the newest sample [s]
        self._applied: set[str] = set()  # variables of the set-points that took effect
        node, of = commander, commander.of
        node.create_subscription(JointState, of(topics.JOINT_STATES), self._on_sample, telemetry_qos())
        node.create_subscription(Int64MultiArray, of(topics.COMMANDS_APPLIED), self._on_applied, telemetry_qos())
        commander.watch()
        commander.wait_for(lambda: self._samples, f"no {of(topics.JOINT_STATES)} were received")

    # ---- motions
    def set_points(self, quantity: str, targets: Mapping[str, float], duration: float) -> str:
        """Command positions, and wait until they are reached; or velocities or efforts for a time.

        Parameters
        ----------
        quantity : {"position", "velocity", "effort"}
            Quantity of the targets.
        targets : mapping of str to float
            Set-points by joint: [rad], [rad/s] or [N m].
        duration : float
            Time for which velocities and efforts are renewed [s]; 0: sent once.

        Raises
        ------
        CommandError
            If the set-points are refused, have no effect, or are not reached.
        """
        joints = {joint.name: joint for joint in self._commander.joints()}
        message = JointState(name=list(targets))
        setattr(message, quantity, list(targets.values()))
        with self.stopped_on_error(list(targets)):
            self._applied.clear()
            ticket = self._commands.send(message, self._commander.timeout)
            if quantity == "position":
                self._arrive({joints[name]: target for name, target in targets.items()})
                return "done: " + self.positions_text(targets)
            self._renew(message, ticket, duration)
            self._commander.wait_for(lambda: _VARIABLES[quantity] in self._applied, "the set-points had no effect")
            if quantity == "velocity" and duration:
                return "done: " + self._reached_velocities(targets)
        return "took effect"

    def follow(self, message: JointTrajectory, progress: Callable[[float], None], duration: float) -> None:
        """Follow a trajectory to its end.

        Parameters
        ----------
        message : JointTrajectory
            The trajectory.
        progress : callable
            Called with the part of `duration` that has passed, 0 .. 1.
        duration : float
            Of the trajectory [s].

        Raises
        ------
        CommandError
            If it is refused, or the joints are not at its end within the tolerance of the bridge.
        """
        with self.stopped_on_error(message.joint_names):
            ticket, begin = self._commands.send(message, self._commander.timeout), 0.0
            while (answer := self._commands.answer(ticket)) is None or not answer.phase.final:
                if answer is None or answer.phase is Phase.ACCEPTED:
                    begin = self._samples[-1][0]
                progress(min((self._samples[-1][0] - begin) / max(duration, 1e-9), 1.0))
                self._step()

    def home(self, joint: str, method: str, position: float | None) -> str:
        """Home a joint; parameters and errors as `Commander.home`."""
        with self.stopped_on_error([joint]):
            self._commands.sent = True
            return self._commander.home(joint, method, position, self._require_telemetry)

    def stop(self, joints: Sequence[str]) -> None:
        """Stop joints with the acceleration limit, and wait until they hold.

        Raises
        ------
        CommandError
            If the bridge refuses, or does not answer.
        """
        self._commander.timeout = min(self._commander.timeout, _SILENCE)
        ticket = self._commands.send(JointTrajectory(joint_names=list(joints)), self._commander.timeout)

        def ended() -> bool:
            answer = self._commands.answer(ticket)
            return answer is not None and answer.phase.final

        self._commander.wait_for(ended, "no answer of the bridge to the stop")

    @contextmanager
    def stopped_on_error(self, joints: Sequence[str]) -> Iterator[None]:
        """Stop joints if the block ends early."""
        try:
            yield
        except CommandError:
            raise  # the motion has ended
        except BaseException:
            if self._commands.sent:
                try:
                    self.stop(joints)
                    complain(f"stopped: {self.positions_text(joints)}")
                except CommandError as error:
                    complain(f"servo-command: not stopped: {error}")
            raise

    def positions_text(self, joints: Sequence[str] | Mapping[str, float]) -> str:
        """Text of the present positions of joints."""
        return ", ".join(f"{joint} at {self._value('position', joint):.4f} rad" for joint in joints)

    # ---- details
    def _renew(self, message: JointState, ticket: str, duration: float) -> None:
        """Repeat set-points for a time [s].

        Raises
        ------
        CommandError
            If they are refused, or this program did not run for long: its joints have stopped, and do not start again.
        """
        renewed = time.monotonic()
        end = renewed + duration
        while time.monotonic() < end:
            pause = min(time.monotonic() + _REPEAT, end)
            while time.monotonic() < pause:
                self._step()
            self._commander.require_armed()
            silent, renewed = time.monotonic() - renewed, time.monotonic()
            if silent > LEASE_TIMEOUT:
                cause = f"this program did not run for {silent:.1f} s: it was suspended, or the computer is too busy"
                try:
                    self.stop(message.name)  # the board may have no time-out
                except CommandError as error:
                    raise CommandError(f"{cause}; the stop is not confirmed: {error}") from None
                raise CommandError(f"{cause}; the joints have stopped")
            self._commands.repeat(message)
            self._commands.answer(ticket)

    def _arrive(self, targets: Mapping[Joint, float]) -> None:
        """Wait until positions are reached."""
        moved, before = self._samples[-1][0], {joint: self._value("position", joint.name) for joint in targets}
        near_since = math.inf
        while True:
            now, present = self._samples[-1][0], {joint: self._value("position", joint.name) for joint in targets}
            distances = {
                joint: abs(joint.nearest(targets[joint], present[joint]) - present[joint]) for joint in targets
            }
            if max(distances.values()) > POSITION_TOLERANCE:
                near_since = math.inf
            elif near_since == math.inf:
                near_since = now
            if now - near_since >= _HELD:
                return
            if any(abs(present[joint] - before[joint]) > _STILL for joint in targets):
                moved, before = now, present
            if now - moved > _STANDSTILL:
                joint = max(targets, key=lambda one: distances[one])
                with suppress(CommandError):  # it does not run there unattended when it is released
                    self.stop([one.name for one in targets])
                raise CommandError(
                    f"{joint.name} stands at {present[joint]:.4f} rad, {distances[joint]:.4f} rad from its target: "
                    "blocked, at a limit, or commanded by another client; see `servo-command state`"
                )
            self._commander.require_armed()
            self._step()

    def _reached_velocities(self, targets: Mapping[str, float]) -> str:
        """Text of the velocities at the end.

        Raises
        ------
        CommandError
            If one is not reached.
        """
        texts = []
        for joint, target in targets.items():
            velocity = self._mean_velocity(joint)
            relative, absolute = _VELOCITY_TOLERANCE
            texts.append(f"{joint} at {velocity:.2f} rad/s")
            if abs(velocity - target) > max(relative * abs(target), absolute):
                raise CommandError(
                    f"{texts[-1]} instead of {target:g} rad/s: the time was too short, or a limit holds it back; see "
                    "`servo-command state`"
                )
        return ", ".join(texts)

    def _mean_velocity(self, joint: str) -> float:
        end = self._samples[-1][0]
        values = [m.velocity[list(m.name).index(joint)] for when, m in self._samples if when >= end - _MEAN]
        return math.fsum(values) / len(values)

    def _value(self, quantity: str, joint: str) -> float:
        message = self._samples[-1][1]
        return float(getattr(message, quantity)[list(message.name).index(joint)])

    def _step(self) -> None:
        self._commander.step()
        self._require_telemetry()

    def _require_telemetry(self) -> None:
        """Raise `CommandError` if none is received any more."""
        if time.monotonic() - self._received > _SILENCE:
            raise CommandError(f"no telemetry for {_SILENCE:g} s: the bridge or its board was lost")

    def _on_sample(self, message: JointState) -> None:
        received, stamp = time.monotonic(), from_stamp(message.header.stamp) * 1e-9
        if self._samples:
            ahead = stamp - self._set - self._samples[-1][0] - (received - self._received)
            if abs(ahead) > _CLOCK_SET:
                self._set += ahead
        self._received = received
        self._samples.append((stamp - self._set, message))

    def _on_applied(self, message: Int64MultiArray) -> None:
        self._applied.add(applied_from_message(message).variable)
