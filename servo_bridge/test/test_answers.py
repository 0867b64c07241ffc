"""Answers to commands with a ticket, and leases of trajectories, over real topics."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator

import pytest
from bridge_rig import FAULT, SPIN, Rig
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from servo_bridge.trajectory_topic import Lease
from servo_msgs_py.answers import LEASE_TIMEOUT, TICKET, Answer, Phase, answer_from_message, answer_message, new_ticket
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.qos import answers_qos, command_qos
from std_msgs.msg import String
from test_trajectory_topics import trajectory
from trajectory_msgs.msg import JointTrajectory

from servo_bridge import trajectory_topic
from servo_msgs_py import topics

CATALOGUE = Catalogue.load()
SHORT = ((0.1, [0.1, 0.0]), (0.2, [0.0, 0.0]))  # ends at the position of the fake board
AWAY = ((0.2, [0.1, 0.0]),)  # the fake board does not move
LONG = ((4.0, [1.0, -1.0]),)


def test_a_lease_lapses_without_renewal() -> None:
    now = [0.0]
    lease = Lease(lambda: now[0])
    now[0] = 0.9 * LEASE_TIMEOUT
    assert not lease.lapsed
    lease.renew()
    now[0] = 1.8 * LEASE_TIMEOUT
    assert not lease.lapsed
    now[0] = 2.0 * LEASE_TIMEOUT
    assert lease.lapsed


@pytest.mark.parametrize("phase", list(Phase))
def test_an_answer_survives_its_message(phase: Phase) -> None:
    answer = Answer(new_ticket("test"), topics.JOINT_TRAJECTORY, phase, "reason", -5)
    assert answer_from_message(answer_message(answer)) == answer
    assert (answer_message(answer).level == DiagnosticStatus.ERROR) == (phase in (Phase.ABORTED, Phase.REFUSED))


def test_a_message_without_fields_is_no_answer() -> None:
    with pytest.raises(ValueError, match="no key 'ticket'"):
        answer_from_message(DiagnosticStatus())


class Sender:
    """Publishes commands with tickets and collects the answers."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        rig.listen(topics.ANSWERS, DiagnosticStatus, answers_qos())
        self._paths = rig.user.create_publisher(JointTrajectory, topics.JOINT_TRAJECTORY, command_qos())
        self._leases = rig.user.create_publisher(String, topics.LEASES, command_qos())
        rig.until(lambda: self._paths.get_subscription_count() and self._leases.get_subscription_count())
        self._numbers = itertools.count()
        self.ticket = ""

    def send(self, *rows: tuple[float, list[float]], joints: tuple[str, ...] = ("axis1", "axis2")) -> JointTrajectory:
        message = trajectory(*rows, joints=joints)
        self.ticket = message.header.frame_id = f"{TICKET}{next(self._numbers)}"
        self._paths.publish(message)
        return message

    def repeat(self, message: JointTrajectory) -> None:
        self._paths.publish(message)

    def renew(self) -> None:
        self._leases.publish(String(data=self.ticket))

    def answers(self) -> list[Answer]:
        found = map(answer_from_message, self.rig.messages[topics.ANSWERS])
        return [answer for answer in found if answer.ticket == self.ticket]

    def phases(self) -> list[Phase]:
        return [answer.phase for answer in self.answers()]

    def until(self, condition: Callable[[], object], timeout: float = 10.0, periods: int = 80) -> None:
        """Deliver samples, each after some PWM periods of the board, until the condition holds."""

        def sampled() -> object:
            self.rig.link.sample(periods)
            self.rig.executor.spin_once(timeout_sec=0.005)
            return condition()

        self.rig.until(sampled, timeout)

    def result(self) -> Answer:
        self.until(lambda: self.answers() and self.answers()[-1].phase.final)
        return self.answers()[-1]


@pytest.fixture
def sender(monkeypatch: pytest.MonkeyPatch) -> Iterator[Sender]:
    with Rig() as rig:
        for name, value in (("speed", 300.0), ("acceleration", 4000.0), ("i_q", 2.0)):
            variable = CATALOGUE[f"param.{name}_limit"]
            rig.link.parameters[variable.name] = [variable.to_raw(value)] * 2
        rig.enable_axes()
        rig.until(lambda: rig.messages[topics.PARAMETERS])
        monkeypatch.setattr(trajectory_topic, "LEASE_TIMEOUT", 600.0)
        yield Sender(rig)


def running(sender: Sender) -> None:
    sender.send(*LONG)
    sender.until(lambda: Phase.RUNNING in sender.phases())


@pytest.mark.realtime
def test_path_to_its_end_succeeds(sender: Sender) -> None:
    message = sender.send(*SHORT)
    assert sender.result().phase is Phase.SUCCEEDED
    assert sender.phases() == [Phase.ACCEPTED, Phase.RUNNING, Phase.SUCCEEDED]
    written = len(sender.rig.link.written)
    sender.repeat(message)  # as a sender does that has not received an answer
    before = sender.ticket
    sender.send((0.5, [1.0]), joints=("elbow",))
    assert sender.result().phase is Phase.REFUSED
    assert "elbow" in sender.answers()[-1].text
    sender.ticket = before
    assert sender.phases() == [Phase.ACCEPTED, Phase.RUNNING, Phase.SUCCEEDED]
    assert len(sender.rig.link.written) == written


@pytest.mark.realtime
def test_shaft_that_does_not_follow_is_aborted(sender: Sender) -> None:
    sender.send(*AWAY)
    answer = sender.result()
    assert (answer.phase, answer.code) == (Phase.ABORTED, -5)
    assert "position of axis1 deviates by 0.1" in answer.text


@pytest.mark.realtime
@pytest.mark.parametrize("event", ["quick_stop", "fault", "set_point", "link", "other_path"])
def test_path_that_is_not_followed_to_its_end_is_aborted(sender: Sender, event: str) -> None:
    rig = sender.rig
    running(sender)
    if event == "quick_stop":
        assert rig.quick_stop()[0]
        text = "stopped by the service quick_stop"
    elif event == "fault":
        rig.link.set_states(FAULT, SPIN)
        text = "axis1 is in FAULT"
    elif event == "set_point":
        command = JointState(name=["axis1"], position=[0.0])
        command.header.frame_id = new_ticket("test")  # otherwise executed later, by the clock of the host
        rig.joint_commands.publish(command)
        text = "a set-point on joint_commands took over"
    elif event == "link":
        rig.link.disconnect()
        rig.until(lambda: sender.phases()[-1].final)
        text = "the link to the board was lost"
    else:
        first = sender.ticket
        sender.send(*SHORT)
        assert sender.result().phase is Phase.SUCCEEDED
        sender.ticket = first
        text = "took over"
    answer = sender.answers()[-1] if event == "link" else sender.result()
    assert answer.phase is Phase.ABORTED
    assert text in answer.text


@pytest.mark.realtime
def test_sender_that_ends_stops_the_joints(sender: Sender, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectory_topic, "LEASE_TIMEOUT", 0.5)
    running(sender)
    end = time.monotonic() + 1.0

    def renewed() -> bool:
        sender.renew()
        return time.monotonic() > end

    sender.until(renewed, periods=8)
    assert sender.phases()[-1] is Phase.RUNNING
    sender.rig.link.written.clear()
    sender.until(lambda: sender.phases()[-1].final, periods=8)
    answer = sender.answers()[-1]
    assert answer.phase is Phase.ABORTED
    assert "has not renewed it" in answer.text
    assert ("cmd.mode", 0, (0, 0)) in sender.rig.link.written


@pytest.mark.realtime
def test_sender_that_ends_before_the_start_of_its_trajectory_stops_nothing(
    sender: Sender, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trajectory_topic, "LEASE_TIMEOUT", 0.2)
    message = trajectory(*LONG)
    message.header.stamp.sec = int(time.time()) + 100
    sender.ticket = message.header.frame_id = f"{TICKET}later"
    sender.repeat(message)
    answer = sender.result()
    assert answer.phase is Phase.REFUSED
    assert answer.text.endswith("cancelled before it began")


@pytest.mark.realtime
def test_an_empty_trajectory_succeeds_when_the_joints_have_stopped(sender: Sender) -> None:
    running(sender)
    first = sender.ticket
    sender.send()
    assert sender.result().phase is Phase.SUCCEEDED
    sender.ticket = first
    assert sender.result().phase is Phase.ABORTED


@pytest.mark.realtime
def test_set_points_with_a_ticket_are_answered_once(sender: Sender) -> None:
    rig = sender.rig
    message = JointState(name=["axis1"], velocity=[5.0])
    sender.ticket = message.header.frame_id = f"{TICKET}set-point"
    for _ in range(5):
        rig.joint_commands.publish(message)
    sender.until(lambda: rig.accepted() >= 5)
    sender.until(sender.phases)
    assert sender.phases() == [Phase.ACCEPTED]
    message.velocity = [1e6]
    rig.joint_commands.publish(message)
    sender.until(lambda: len(sender.phases()) > 1)
    assert sender.phases()[1:] == [Phase.REFUSED]
    assert "velocity of axis1" in sender.answers()[-1].text


@pytest.mark.realtime
def test_commands_without_a_ticket_are_not_answered(sender: Sender) -> None:
    rig = sender.rig
    message = trajectory(*SHORT)
    message.header.frame_id = "base_link"
    sender.repeat(message)
    rig.joint_commands.publish(JointState(name=["elbow"], position=[0.0]))
    sender.until(lambda: rig.rejections() and rig.accepted())
    assert rig.messages[topics.ANSWERS] == []
