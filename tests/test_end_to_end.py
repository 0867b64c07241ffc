"""The complete chain: firmware and plant on a real pty, bridge and twin as processes, a ROS client."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from chain import Chain, Process, User, followed_board, ros_user, wait_for
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from servo_msgs_py.convert import from_stamp, snapshot_table
from servo_msgs_py.runtime.qos import command_qos, latched_qos
from servo_msgs_py.units import PERIOD_NS
from servo_twin.level import LEVEL_VARIABLE, Level, chosen_level
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

TURN = 2.0 * math.pi
COUNT = TURN / 4000
# Half a count of rounding, two counts of the encoder, and two counts at the end of a move by the dead time of the
# switching plant (experiment feed-forward).
OVERSHOOT = (2.5 if chosen_level() == "ideal" else 4.5) * COUNT
BOTH = ["axis1", "axis2"]
SPIN = "axis1=RUN/SPIN axis2=RUN/SPIN"
STOP = "axis1=STOP axis2=STOP"


@pytest.fixture(scope="class")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[User]:
    """Board, bridge and twin, shared by the tests of normal operation."""
    with followed_board(tmp_path_factory.mktemp("chain")) as user:
        yield user


@pytest.fixture
def user(running: User) -> User:
    """ROS client with both axes in SPIN and at rest."""
    if running.last("/servo/state") != SPIN or not running.last("/servo/armed"):
        running.enable_axes()
    running.until(lambda: at_rest(running), what="the shafts do not rest")
    return running


@pytest.fixture
def chain(tmp_path: Path) -> Iterator[Chain]:
    """Separate chain for tests with failures; default level: `ideal`, which takes less time."""
    chain = Chain(tmp_path, level=None if LEVEL_VARIABLE in os.environ else "ideal")
    try:
        yield chain
    finally:
        chain.end()
        print(chain.logs())


def at_rest(user: User) -> bool:
    newest = [m.position for m in user.messages["/servo/joint_states"][-20:]]
    return len(newest) == 20 and bool(np.all(np.ptp(np.array(newest), axis=0) <= 2 * COUNT))


def reached(user: User, *targets: float) -> Callable[[], bool]:
    """Condition: both shafts are at rest within two counts of their targets [rad]."""

    def in_position() -> bool:
        return at_rest(user) and all(
            abs(user.position_of(k) - target) <= 2.5 * COUNT for k, target in enumerate(targets)
        )

    return in_position


def go(user: User, *targets: float) -> None:
    """Move both axes to targets [rad] and wait until they arrive."""
    user.joint_commands.publish(JointState(name=BOTH, position=list(targets)))
    user.until(reached(user, *targets), 10.0, f"not at {targets}")


class TestNormalWork:
    def test_position_topic_of_one_joint_moves_its_shaft(self, user: User) -> None:
        go(user, 0.0, 0.0)
        user.position[0].publish(Float64(data=TURN))
        user.until(reached(user, TURN, 0.0), 10.0)

    def test_both_joints_move_from_the_same_tick(self, user: User) -> None:
        go(user, 0.0, 0.0)
        start = len(user.messages["/servo/snapshot"])
        before = len(user.applied())
        go(user, 5 * TURN, -5 * TURN)
        (written,) = user.applied()[before:]
        assert (written.variable, written.mask) == ("cmd.position", 3)
        rows = user.rows(start)
        for axis in BOTH:  # the shapes differ between the axes, the starts are equal
            moving = next(r["tick"] for r in rows if abs(r[f"{axis}.position_ref"]) > 5 * COUNT)
            assert 0.0 < (moving - written.tick) * PERIOD_NS * 1e-9 < 0.05
        # No overshoot: the largest position is within the permitted error at rest.
        assert max(r["axis1.position"] for r in rows) <= 5 * TURN + OVERSHOOT
        assert min(r["axis2.position"] for r in rows) >= -5 * TURN - OVERSHOOT

    def test_shaft_stops_when_the_speed_set_point_expires(self, user: User) -> None:
        user.joint_commands.publish(JointState(name=["axis1"], velocity=[50.0]))
        user.until(lambda: user.messages["/servo/joint_states"][-1].velocity[0] > 45.0, 5.0)
        user.until(lambda: at_rest(user), 5.0)
        assert user.last("/servo/state") == SPIN

    def test_quick_stop_holds_until_enable(self, user: User) -> None:
        go(user, 0.0, 0.0)
        user.joint_commands.publish(JointState(name=BOTH, position=[40 * TURN, -40 * TURN]))
        user.until(lambda: user.position_of(0) > 10 * TURN, 5.0)
        assert user.quick_stop()[0]
        user.until(lambda: at_rest(user), 5.0)
        assert 10 * TURN < user.position_of(0) < 30 * TURN
        assert user.last("/servo/state") == SPIN
        held = user.position_of(0)
        user.position[0].publish(Float64(data=0.0))
        user.wait_board_time(0.3)
        assert user.position_of(0) == pytest.approx(held, abs=2 * COUNT)
        user.enable_axes()
        go(user, 0.0, 0.0)

    def test_twin_follows_the_board(self, user: User) -> None:
        user.until(lambda: user.last("/twin/healthy") is True)
        start, residuals = len(user.messages["/twin/joint_states"]), len(user.messages["/twin/residual"])
        go(user, 3 * TURN, -2 * TURN)
        go(user, 0.0, 0.0)
        newest = from_stamp(user.messages["/servo/joint_states"][-1].header.stamp)
        user.until(lambda: from_stamp(user.messages["/twin/residual"][-1].header.stamp) >= newest, 5.0)
        twin = [m for m in user.messages["/twin/joint_states"][start:] if from_stamp(m.header.stamp) <= newest]
        real = {from_stamp(m.header.stamp): m for m in user.messages["/servo/joint_states"]}
        assert max(m.position[0] for m in twin) > 2.9 * TURN
        # The stamps are equal, and the residual is the difference.
        assert all(from_stamp(m.header.stamp) in real for m in twin)
        by_stamp = {from_stamp(m.header.stamp): m for m in twin}
        compared = [m for m in user.messages["/twin/residual"][residuals:] if from_stamp(m.header.stamp) in by_stamp]
        stamps = [from_stamp(m.header.stamp) for m in compared]
        meanwhile = [stamp for stamp in real if stamps[0] <= stamp <= newest]
        assert len(meanwhile) > 30
        assert len(set(stamps) & set(meanwhile)) >= 0.95 * len(meanwhile)
        for message in compared:
            stamp = from_stamp(message.header.stamp)
            difference = np.array(real[stamp].position) - np.array(by_stamp[stamp].position)
            assert list(message.position) == pytest.approx(list(difference), abs=1e-9)
            assert np.max(np.abs(message.position)) < 0.05
            assert np.max(np.abs(message.velocity)) < 10.0
        assert user.last("/twin/healthy") is True
        assert user.last("/twin/state") == SPIN

    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
    def test_path_stops_when_its_command_is_interrupted(self, user: User, tmp_path: Path, number: int) -> None:
        terminal = Chain(tmp_path)
        try:
            command = terminal.script(
                "servo-command", "sine", "axis1", "--amplitude", "6", "--frequency", "1", "--for", "10"
            )
            user.until(lambda: abs(user.messages["/servo/joint_states"][-1].velocity[0]) > 30.0, 20.0, "no motion")
            assert command.stop(number) == 128 + number
        finally:
            terminal.end()
            print(terminal.logs())
        assert "stopped: axis1 at " in command.text()
        user.until(lambda: at_rest(user), 5.0, "the shaft does not hold")
        user.wait_board_time(1.0)  # a period of the sine
        assert at_rest(user)
        assert user.last("/servo/state") == SPIN

    def test_disable_switches_off_and_refuses_set_points(self, user: User) -> None:
        assert user.enable(False)[0]
        user.until(lambda: user.last("/servo/state") == STOP)
        assert user.last("/servo/armed") is False
        where = user.position_of(0)
        refused = len(user.rejections())
        user.position[0].publish(Float64(data=where + TURN))
        user.until_rejected(refused)
        user.wait_board_time(0.2)
        assert user.position_of(0) == pytest.approx(where, abs=2 * COUNT)
        user.enable_axes()
        user.wait_board_time(0.3)
        assert user.position_of(0) == pytest.approx(where, abs=100 * COUNT)


class TestParameters:
    """Boards with parameters that differ from those after reset."""

    def test_twin_takes_parameters_of_the_board_and_follows_it(self, chain: Chain) -> None:
        chain.board()
        features = "ANTI_WINDUP+ENHANCED_MT+BUS_COMPENSATION+DEAD_TIME"
        # Set by the tool before the bridge starts.
        chain.tool("set", "param.features[0]", f"{features}+SPEED_FORWARD+ACCELERATION_FORWARD")
        chain.tool("set", "param.speed_limit", "150,90")
        chain.bridge(board_parameters=["param.i_q_limit=2.0,2.5", f"param.features[1]={features}+POSITION_LIMITS"])
        chain.twin()
        with ros_user() as user:
            user.until(user.connected, 30.0)
            user.until(lambda: user.last("/twin/healthy") is True, 30.0)
            user.enable_axes()
            user.until(lambda: user.last("/twin/healthy") is True, 30.0)
            self.check(user, 5.0, -5.0)
            # Set during operation, as by `ros2 param set`.
            healths = len(user.messages["/twin/healthy"])
            done, reason = user.set_board_parameters("param.position_min[1]=-10", "param.position_max[1]=10")
            assert done, reason
            user.joint_commands.publish(JointState(name=BOTH, position=[0.0, 31.4]))
            user.until(reached(user, 0.0, 10.0))
            assert all(message.data for message in user.messages["/twin/healthy"][healths:])  # nothing to synchronise
            user.until(lambda: "POSITION: a soft limit" in user.status("servo/servo_bridge: axis2").message, 5.0)
            done, reason = user.set_board_parameters("param.position_min[1]=11")
            assert not done
            assert "param.position_min[1] 11.0003 rad exceeds param.position_max[1]" in reason

    def check(self, user: User, *turns: float) -> None:
        known = len(user.messages["/twin/residual"])
        go(user, *(x * TURN for x in turns))
        residuals = user.messages["/twin/residual"][known:]
        assert len(residuals) > 50
        assert np.max(np.abs([m.position for m in residuals])) < 0.05
        assert user.last("/twin/healthy") is True


def square() -> JointTrajectory:
    """Square of both axes, at rest in every corner."""
    corners = ((TURN, 0.0), (TURN, -TURN), (0.0, -TURN), (0.0, 0.0))
    points = [
        JointTrajectoryPoint(
            positions=list(corner), velocities=[0.0, 0.0], time_from_start=Duration(nanosec=200_000_000 * (k + 1))
        )
        for k, corner in enumerate(corners)
    ]
    return JointTrajectory(joint_names=BOTH, points=points)


RECORDED = ("axis1.i_a", "axis1.i_q", "axis1.position", "axis2.duty_a")


class Recordings:
    """Recordings of the board and of the twin."""

    TOPICS = ("/servo/recording", "/twin/recording", "/twin/residual/recording")

    def __init__(self, user: User) -> None:
        self._user = user
        self._record = user.node.create_client(SetBool, "/servo/record")
        for name in self.TOPICS:
            user.listen(name, Float64MultiArray, latched_qos())

    def begin(self) -> None:
        """Start the recorder."""
        self._user.until(self._record.service_is_ready)
        success, message = self._user.call(self._record, SetBool.Request(data=True))
        assert success, message

    def assert_equal(self) -> None:
        """Board and twin have one recording each, with equal data."""
        self._user.until(lambda: all(self._user.messages[name] for name in self.TOPICS), what="no burst")
        (board,), (twin,), (residual,) = (self._user.messages[name] for name in self.TOPICS)
        assert snapshot_table(board)[0][1 : len(RECORDED) + 1] == list(RECORDED)
        assert board.layout == twin.layout == residual.layout
        assert board.data == twin.data
        columns, table = snapshot_table(residual)
        assert not table[:, 1 : columns.index("time")].any()
        assert np.ptp(snapshot_table(twin)[1][:, columns.index("axis1.i_a")]) > 0.0


class TestTwinOfTheSameBoard:
    """Both boards have the same noise: a difference could only come from the line or from the split of the runs."""

    @pytest.fixture(autouse=True, params=get_args(Level))
    def _level(self, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv(LEVEL_VARIABLE, request.param)

    def test_residual_is_exactly_zero(self, chain: Chain) -> None:
        with ros_user() as user:
            chain.twin(seed=5)
            recording = f"{' '.join(RECORDED)} --rate 2000"
            chain.bridge(gear_ratio=[1.0, 1.5], direction=[1, -1], offset=[0.0, 0.5], recording=recording)
            # At level registers a recorder shifts the reading of the encoders, at different ticks of the boards.
            recordings = Recordings(user) if chosen_level() == "ideal" else None
            user.until(lambda: user.matched() and user.last("/twin/state"), 30.0)
            chain.board(seed=5)  # last, so that the twin can follow it from its reset
            user.until(user.connected, 30.0)
            user.until(lambda: user.last("/twin/healthy") is True, 30.0)
            user.enable_axes()
            start = from_stamp(user.messages["/servo/joint_states"][-1].header.stamp)
            if recordings is not None:
                recordings.begin()
            for turns in ((2.0, -3.0), (-1.0, 0.25)):
                go(user, *(x * TURN for x in turns))
            if recordings is not None:
                recordings.assert_equal()
            trajectories = user.node.create_publisher(JointTrajectory, "/servo/joint_trajectory", command_qos())
            user.until(trajectories.get_subscription_count)
            trajectories.publish(square())
            user.until(lambda: user.position_of(1) < -0.9 * TURN, 10.0)
            user.until(reached(user, 0.0, 0.0), 10.0)
            end = from_stamp(user.messages["/servo/joint_states"][-1].header.stamp)
            residuals = user.messages["/twin/residual"]
            user.until(lambda: residuals and from_stamp(residuals[-1].header.stamp) >= end)
            values = [(from_stamp(m.header.stamp), *m.position, *m.velocity, *m.effort) for m in residuals]
            assert [row for row in values if any(row[1:])] == []
            assert len([m for m in residuals if from_stamp(m.header.stamp) >= start]) > 20


@dataclass
class RunningChain:
    """Chain with all processes, and a ROS client."""

    chain: Chain
    user: User
    board: Process
    bridge: Process
    twin: Process


@pytest.fixture(scope="class")
def running_chain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningChain]:
    chain = Chain(tmp_path_factory.mktemp("chain"), level="ideal")
    with ros_user() as user:
        try:
            yield RunningChain(chain, user, chain.board(), chain.bridge(), chain.twin())
        finally:
            chain.end()
            print(chain.logs())


class TestTrouble:
    """Other failures: test_failures_bridge.py."""

    def test_board_is_used_again_after_its_restart(self, running_chain: RunningChain) -> None:
        user = running_chain.user
        user.until(user.connected, 30.0)
        user.enable_axes()
        go(user, TURN, -TURN)
        user.until(lambda: user.last("/twin/healthy") is True, 20.0)
        running_chain.board.kill()
        user.until(lambda: user.link_level() == DiagnosticStatus.ERROR)
        user.until(lambda: user.last("/servo/armed") is False)
        user.until(lambda: user.last("/twin/healthy") is False)
        user.until(lambda: user.status("servo/servo_bridge: link").level == b"\x02")
        assert not user.enable()[0]
        user.position[0].publish(Float64(data=9 * TURN))  # while the board is off
        running_chain.chain.port.unlink()
        running_chain.board = running_chain.chain.board(seed=6)
        user.until(lambda: user.last("/servo/state") == STOP, 20.0)
        user.wait_board_time(0.5)
        assert user.last("/servo/state") == STOP
        assert user.last("/servo/armed") is False
        user.until(lambda: user.last("/twin/healthy") is True, 20.0)
        user.enable_axes()
        user.wait_board_time(0.3)
        assert user.position_of(0) == pytest.approx(0.0, abs=0.2)  # earlier set-points are discarded
        go(user, 2 * TURN, 0.0)
        user.until(lambda: user.last("/twin/healthy") is True)
        assert running_chain.bridge.running

    def test_ctrl_c_switches_off_and_ends_all_processes(self, running_chain: RunningChain) -> None:
        user, chain = running_chain.user, running_chain.chain
        user.until(user.connected, 30.0)
        user.enable_axes()
        start = user.position_of(0)
        user.joint_commands.publish(JointState(name=BOTH, position=[50 * TURN, -50 * TURN]))
        user.until(lambda: user.position_of(0) > start + TURN, 5.0)
        assert running_chain.bridge.stop(signal.SIGINT) == 0
        user.until(lambda: user.last("/servo/armed") is False)
        user.until(lambda: user.link_level() == DiagnosticStatus.ERROR)
        user.until(lambda: user.last("/twin/healthy") is False)
        seen = chain.read_variables("axis1.state", "axis2.state", "cmd.enable", "axis1.faults")
        assert seen["cmd.enable"] == [0, 0]
        assert seen["axis1.faults"] == 0
        wait_for(
            lambda: chain.read_variables("axis1.state", "axis2.state") == {"axis1.state": 2, "axis2.state": 2}, 10.0
        )
        for process in (running_chain.twin, running_chain.board):
            assert process.stop(signal.SIGINT) == 0
        assert chain.processes() == {}
        assert not chain.port.exists()
        assert "Traceback" not in chain.logs()
