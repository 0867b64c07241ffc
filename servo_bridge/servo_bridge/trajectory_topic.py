"""The topic ``joint_trajectory``: trajectories with a ticket are answered and have a lease."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Final

from servo_msgs_py.answers import LEASE_TIMEOUT, TICKET, Answer, Phase
from servo_msgs_py.runtime.qos import command_qos
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from servo_bridge.answers import Answers
from servo_bridge.command_context import CommandContext
from servo_bridge.goals import Goals
from servo_bridge.set_points import Rejected
from servo_bridge.trajectory import tolerances
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.follower import PathEvents
from servo_bridge.trajectory.goal import Goal, GoalDefaults
from servo_bridge.trajectory.message import BYTES_MAX, TrajectoryMessage, read
from servo_bridge.trajectory.path import State
from servo_msgs_py import topics

_SOURCE: Final = topics.JOINT_TRAJECTORY

_LAPSED: Final = f"its sender has not renewed it for {LEASE_TIMEOUT:g} s (ended, suspended, too slow, or lost)"


class Lease:
    """Permission to continue a motion, which ends unless it is renewed.

    Parameters
    ----------
    clock : callable
        Steady time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.renew()

    def renew(self) -> None:
        self._until = self._clock() + LEASE_TIMEOUT

    @property
    def lapsed(self) -> bool:
        return self._clock() > self._until


class _Sender:
    """Sender of a trajectory with a ticket."""

    def __init__(
        self, ticket: str, lease: Lease | None, answer: Callable[[Answer], None], warn: Callable[[str], None]
    ) -> None:
        self._ticket = ticket
        self._lease = lease  # None: the joints are being stopped
        self._answer, self._warn = answer, warn
        self._begun = False

    def cancelling(self) -> bool:
        return self._lease is not None and self._lease.lapsed

    def begun(self) -> None:
        self._begun = True
        self._say(Phase.RUNNING)

    def postponed(self) -> None:
        self._begun = False
        self._say(Phase.ACCEPTED)

    def moving(self, tick: int, stamp_ns: int, desired: State, actual: State) -> None:
        pass

    def ended(self, goal: Goal) -> None:
        outcome = goal.outcome
        if outcome.phase is tolerances.Phase.SUCCEEDED:
            self._say(Phase.SUCCEEDED, outcome.text)
        else:
            text = f"{_LAPSED}: {outcome.text}" if goal.canceled else outcome.text
            self._warn(f"the trajectory {self._ticket} of {', '.join(goal.joints)} has ended: {text}")
            self._say(Phase.ABORTED if self._begun else Phase.REFUSED, text, outcome.code)

    def _say(self, phase: Phase, text: str = "", code: ErrorCode = ErrorCode.SUCCESSFUL) -> None:
        self._answer(Answer(self._ticket, _SOURCE, phase, text, int(code)))


class TrajectoryTopic:
    """Subscriptions of trajectories and of their leases.

    Parameters
    ----------
    context : CommandContext
        Node, and counters of refusals.
    goals : Goals
        Follows trajectories.
    answers : Answers
        Publisher of the answers.
    defaults : GoalDefaults
        Tolerances at the end.
    warn : callable
        Receives messages for the log.
    """

    def __init__(
        self,
        context: CommandContext,
        goals: Goals,
        answers: Answers,
        defaults: GoalDefaults,
        warn: Callable[[str], None],
    ) -> None:
        self._context, self._goals = context, goals
        self._answers, self._defaults, self._warn = answers, defaults, warn
        self._leases: dict[str, Lease] = {}  # by ticket
        node, qos = context.node, command_qos()
        node.create_subscription(JointTrajectory, _SOURCE, self._on_message, qos, raw=True, bytes_max=BYTES_MAX)
        node.create_subscription(String, topics.LEASES, self._on_renewal, qos)

    def _on_renewal(self, message: String) -> None:
        if message.data in self._leases:
            self._leases[message.data].renew()

    def _on_message(self, data: bytes) -> None:
        try:
            message = read(data)
        except TrajectoryError as error:
            self._context.reject(_SOURCE, TrajectoryError(f"{_SOURCE}: {error}", error.code))
        else:
            self._on_trajectory(message)

    def _on_trajectory(self, message: TrajectoryMessage) -> None:
        ticket = message.frame_id
        if self._answers.known(ticket):
            return  # repeated by its sender, which has not received the answer yet
        try:
            if ticket.startswith(TICKET):
                self._begin(ticket, message)
            elif message.size:
                reject = partial(self._context.reject, _SOURCE)
                self._goals.follow(_SOURCE, message, PathEvents(lambda _: None, reject, postponed=lambda: True))
            else:
                self._goals.stop(_SOURCE, message.joint_names)
        except Rejected as error:
            self._context.reject(_SOURCE, error)
            code = error.code if isinstance(error, TrajectoryError) else ErrorCode.INVALID_GOAL
            self._answers.publish(Answer(ticket, _SOURCE, Phase.REFUSED, str(error), int(code)))

    def _begin(self, ticket: str, message: TrajectoryMessage) -> None:
        joints = self._goals.joints_of(message.joint_names)
        no_path_tolerance = tolerances.tolerances_from((), joints, {})
        at_end = tolerances.tolerances_from((), joints, self._defaults.goal)
        goal = Goal(joints, no_path_tolerance, at_end, self._defaults.goal_time)
        lease = Lease() if message.size else None
        self._goals.begin(_SOURCE, message, goal, _Sender(ticket, lease, self._publish, self._warn))
        self._publish(Answer(ticket, _SOURCE, Phase.ACCEPTED))
        if lease is not None:
            self._leases[ticket] = lease

    def _publish(self, answer: Answer) -> None:
        if answer.phase.final:
            self._leases.pop(answer.ticket, None)
        self._answers.publish(answer)
