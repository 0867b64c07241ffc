"""The twin node with rclpy; the telemetry is that of a virtual board that is not paced."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from numpy.typing import NDArray
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from servo_msgs_py.convert import (
    AppliedCommand,
    applied_message,
    from_stamp,
    parameters_message,
    snapshot_message,
    snapshot_table,
)
from servo_msgs_py.joints import DEFAULT_JOINTS, Joint
from servo_msgs_py.robot_description import describe
from servo_msgs_py.run_file.run_info import RunInfo
from servo_msgs_py.runtime.parameters import ParameterError
from servo_msgs_py.runtime.qos import latched_qos, telemetry_qos
from servo_msgs_py.units import PERIOD_NS
from servo_twin.fault_injection import SlippedEncoder
from servo_twin.node import ServoTwin, main
from std_msgs.msg import Bool, Float64, Float64MultiArray, Int64MultiArray, String
from std_srvs.srv import Trigger
from twin_rig import CATALOGUE, EPOCH_NS, TwinRig

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

DOMAIN = int(os.environ.get("ROS_DOMAIN_ID", "0")) or 1 + os.getpid() % 100
BATCH = 5  # samples in a message, as the bridge sends them


class Rig:
    """Twin node, a node in place of bridge and user, and the board, on one executor."""

    def __init__(
        self,
        cli_args: list[str] | None = None,
        joints: Sequence[Joint] = DEFAULT_JOINTS,
        *,
        configured: bool = True,
        **parameters: Any,
    ) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.executor = EventsExecutor(context=self.context)
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        try:
            self.node = ServoTwin(context=self.context, cli_args=cli_args, parameter_overrides=overrides)
        except BaseException:
            rclpy.shutdown(context=self.context)
            raise
        self.user = Node("user", namespace="servo", context=self.context)
        deep, latched = telemetry_qos(1000), latched_qos()
        self.snapshot = self.user.create_publisher(Float64MultiArray, topics.SNAPSHOT, deep)
        self.applied = self.user.create_publisher(Int64MultiArray, topics.COMMANDS_APPLIED, deep)
        self.link = self.user.create_publisher(DiagnosticStatus, topics.LINK, latched)
        self.board_parameters = self.user.create_publisher(Float64MultiArray, topics.PARAMETERS, latched)
        self.description = self.user.create_publisher(String, topics.ROBOT_DESCRIPTION, latched)
        self.tuning = self.user.create_publisher(Int64MultiArray, topics.TUNING, latched)
        self.messages: dict[str, list[Any]] = {}
        self._listen("/twin/joint_states", JointState, deep)
        self._listen("/twin/snapshot", Float64MultiArray, deep)
        self._listen("/twin/residual", JointState, deep)
        if configured:
            self.tuning.publish(Int64MultiArray())  # unknown to the bridge
        if joints:
            self.describe(joints)
            self._listen(f"/twin/residual/{joints[0].name}/position", Float64, deep)
        self._listen("/diagnostics", DiagnosticArray, deep)
        self._listen("/twin/state", String, latched)
        self._listen("/twin/healthy", Bool, latched)
        self.resync = self.user.create_client(Trigger, "/twin/resync")
        self.executor.add_node(self.node)
        self.executor.add_node(self.user)
        self.board = TwinRig(real_seed=5)
        self.board.twin.close()
        self.board.twin = self  # type: ignore[assignment]
        self._rows: list[list[float]] = []
        self._columns: list[str] = []
        self.until(self._matched, 20.0)

    def _listen(self, name: str, kind: Any, qos: Any) -> None:
        self.messages[name] = []
        self.user.create_subscription(kind, name, self.messages[name].append, qos)

    def describe(self, joints: Sequence[Joint]) -> None:
        """Publish the description of the joints."""
        text = describe(joints, CATALOGUE, commands_topic="/servo/joint_commands", states_topic="/servo/joint_states")
        self.description.publish(String(data=text))

    def _matched(self) -> bool:
        publishers = (self.snapshot, self.applied, self.link, self.board_parameters, self.description, self.tuning)
        return (
            all(p.get_subscription_count() for p in publishers)
            and all(self.user.count_publishers(name) for name in self.messages)
            and self.resync.service_is_ready()
            and bool(self.messages["/twin/state"] and self.messages["/twin/healthy"])
        )

    # ---- the board's twin, over ROS
    def add_samples(self, columns: Sequence[str], table: NDArray[np.float64]) -> None:
        self._columns = list(columns)
        self._rows += table.tolist()
        if len(self._rows) >= BATCH:
            self.snapshot.publish(snapshot_message(self._columns, self._rows))
            self._rows.clear()
            self.executor.spin_once(timeout_sec=0.0)

    def add_command(self, command: AppliedCommand) -> None:
        self.applied.publish(applied_message(command))

    def set_parameters(self, values: dict[str, list[int]]) -> None:
        self.board_parameters.publish(parameters_message(values, CATALOGUE))

    def step(self) -> list[Any]:
        return []

    def close(self) -> None:
        """Nothing to close."""

    # ---- steps
    def until(self, condition: Callable[[], object], timeout: float = 10.0) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, (self.last("/twin/state"), self.last("/twin/healthy"))
            self.executor.spin_once(timeout_sec=0.01)

    def caught_up(self) -> None:
        """The twin has published the newest full batch."""
        newest = self.board.real.tick - len(self._rows) * self.board.every
        self.until(lambda: (rows := self.rows(last=1)) and rows[-1]["tick"] == newest)

    def last(self, name: str) -> Any:
        return self.messages[name][-1].data if self.messages[name] else None

    def rows(self, last: int = 0) -> list[dict[str, float]]:
        """Samples of the twin; of the last messages only, if `last` is not 0."""
        return [
            dict(zip(names, row, strict=True))
            for names, table in map(snapshot_table, self.messages["/twin/snapshot"][-last:])
            for row in table.tolist()
        ]

    def status(self, part: str) -> DiagnosticStatus:
        found = [s for m in self.messages["/diagnostics"] for s in m.status if s.name == f"twin/servo_twin: {part}"]
        return found[-1] if found else DiagnosticStatus(message="no diagnostics yet")

    def comparison_messages(self) -> list[str]:
        """All messages of the comparison in the diagnostics."""
        return [s.message for m in self.messages["/diagnostics"] for s in m.status if s.name.endswith(": comparison")]

    def residual_ticks(self) -> dict[int, JointState]:
        """Residuals by the tick of their real sample."""
        messages = self.messages["/twin/residual"]
        return {(from_stamp(m.header.stamp) - EPOCH_NS) // PERIOD_NS: m for m in messages}

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self.executor.remove_node(self.node)
        self.executor.remove_node(self.user)
        self.node.shutdown()
        self.user.destroy_node()
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)
        self.board.real.close()


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as rig:
        yield rig


def test_state_reports_waiting_for_telemetry(rig: Rig) -> None:
    assert rig.last("/twin/state") == "SYNCHRONISING no telemetry yet"
    assert rig.last("/twin/healthy") is False
    rig.until(lambda: rig.status("comparison").message == "no telemetry from /servo")
    assert rig.status("comparison").level == b"\x01"
    assert rig.status("simulation").level == b"\x00"


def test_twin_follows_the_board_and_publishes_its_topics(rig: Rig) -> None:
    rig.board.enable_axes()
    rig.board.move([2.0, -1.0])
    rig.caught_up()
    joints, rows = rig.messages["/twin/joint_states"], rig.rows()
    rig.until(lambda: len(joints) == len(rig.rows()))
    rows = rig.rows()
    assert rig.last("/twin/state") == "axis1=RUN/SPIN axis2=RUN/SPIN"
    assert list(rows[0]) == [*(name for name in rows[0] if not name.startswith("stamp")), "stamp.sec", "stamp.nanosec"]
    assert next(iter(rows[0])) == "tick"
    assert [row["tick"] for row in rows] == [96.0 * k for k in range(1, len(rows) + 1)]
    for message, row in zip(joints, rows, strict=True):
        stamp = EPOCH_NS + int(row["tick"]) * PERIOD_NS
        assert from_stamp(message.header.stamp) == stamp
        assert (int(row["stamp.sec"]), int(row["stamp.nanosec"])) == divmod(stamp, 1_000_000_000)
        assert list(message.position) == [row["axis1.position"], row["axis2.position"]]
        assert list(message.velocity) == [row["axis1.speed"], row["axis2.speed"]]
    assert joints[-1].position[0] == pytest.approx(4 * np.pi, abs=0.02)
    assert list(joints[-1].name) == ["axis1", "axis2"]
    # 3/2 p psi_m of the firmware's nominal values
    assert joints[-1].effort[0] == pytest.approx(rows[-1]["axis1.i_q"] * 0.0462, rel=1e-3)


def test_joints_residuals_and_state_are_those_of_the_description() -> None:
    joints = [Joint("lift", 50.0, -1, 0.3), Joint("pan", 2.0)]
    with Rig(joints=joints) as rig:
        rig.board.enable_axes()
        rig.board.move([2.0, -1.0])
        rig.caught_up()
        rig.until(lambda: len(rig.messages["/twin/joint_states"]) == len(rig.rows()))
        last, row = rig.messages["/twin/joint_states"][-1], rig.rows()[-1]
        assert list(last.name) == ["lift", "pan"]
        for k, joint in enumerate(joints):
            assert last.position[k] == joint.position(row[f"axis{k + 1}.position"])
            assert last.velocity[k] == joint.velocity(row[f"axis{k + 1}.speed"])
        assert last.position[0] == pytest.approx(0.3 - 4.0 * np.pi / 50.0, abs=0.001)
        rig.until(lambda: row["tick"] in rig.residual_ticks())
        worst = [max(abs(m.position[k]) for m in rig.residual_ticks().values()) for k in range(2)]
        assert 0.0 < worst[0] < 0.03 / 50.0
        assert 0.0 < worst[1] < 0.03 / 2.0
        assert rig.last("/twin/state") == "lift=RUN/SPIN pan=RUN/SPIN"
        assert rig.messages["/twin/residual/lift/position"]


def test_without_a_description_nothing_is_compared_in_unknown_units() -> None:
    with Rig(joints=[]) as rig:
        rig.board.run(0.7)
        rig.caught_up()
        missing = "joints unknown: no message on /servo/robot_description"
        rig.until(lambda: rig.last("/twin/state") == f"SYNCHRONISING {missing}")
        rig.until(lambda: missing in rig.comparison_messages())
        assert rig.last("/twin/healthy") is False
        assert not rig.messages["/twin/joint_states"]
        rig.description.publish(String(data="<robot/>"))
        rig.describe([Joint("arm", 2.0), Joint("wheel")])
        rig.until(lambda: rig.last("/twin/state") == "arm=STOP wheel=STOP")
        rig.board.run(0.7)
        rig.until(lambda: rig.last("/twin/healthy"))
        rig.describe([Joint("left"), Joint("right")])
        rig.until(lambda: rig.user.count_publishers("/twin/residual/right/i_q"))
        rig.until(lambda: not rig.user.count_publishers("/twin/residual/wheel/i_q"))


def test_residuals_are_stamped_with_the_real_sample_and_left_out_while_searching(rig: Rig) -> None:
    rig.board.enable_axes()
    rig.board.move([2.0, -1.0])
    rig.caught_up()
    newest = rig.rows()[-1]["tick"]
    rig.until(lambda: newest in rig.residual_ticks())
    ticks = rig.residual_ticks()
    searching = {int(row["tick"]) for row in rig.rows() if row["axis1.substate"] == 2 and row["axis1.state"] == 3}
    assert searching
    assert not searching & set(ticks)
    worst = max(max(map(abs, m.position)) for m in ticks.values())
    assert 0.0 < worst < 0.03
    assert all(len(m.position) == len(m.velocity) == len(m.effort) == 2 for m in ticks.values())
    single = rig.messages["/twin/residual/axis1/position"]
    assert 3 <= len(single) < len(ticks) / 3


def test_healthy_after_small_residuals_for_the_hold_time_and_not_while_synchronising(rig: Rig) -> None:
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))
    rig.board.write("cmd.enable", [1, 1])
    rig.board.until("RUN/SPIN")
    rig.board.run(0.7)
    rig.until(lambda: [m.data for m in rig.messages["/twin/healthy"]] == [False, True, False, True])
    assert rig.last("/twin/state") == "axis1=RUN/SPIN axis2=RUN/SPIN"


def test_a_board_in_fault_makes_the_twin_unhealthy_until_the_fault_is_cleared(
    rig: Rig, capfd: pytest.CaptureFixture[str]
) -> None:
    """Fault ANGLE_MISMATCH of the board alone: the encoder of the twin does not slip."""
    rig.board.set_parameters("param.features[0]=ANTI_WINDUP+ENHANCED_MT+BUS_COMPENSATION+DEAD_TIME+ANGLE_CHECK")
    rig.board.enable_axes()
    rig.board.write("cmd.mode", [1, 1])
    rig.board.write("cmd.speed", [60.0, 0.0])
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))
    rig.board.board.inject(SlippedEncoder(0, 667))
    rig.board.until("FAULT", axes=[0])
    (flag,) = [flag for flag in CATALOGUE.flags["faults"] if flag.name == "ANGLE_MISMATCH"]
    named = f"axis1 of the board is in FAULT (ANGLE_MISMATCH: {flag.cause})"
    rig.until(lambda: rig.last("/twin/healthy") is False)
    for _ in range(4):
        rig.board.run(1.0)
        rig.caught_up()
    rig.until(lambda: rig.last("/twin/state") == "axis1=STOP axis2=RUN/SPIN")
    rig.until(lambda: named in rig.comparison_messages())
    assert rig.last("/twin/healthy") is False
    rig.board.write("cmd.clear_faults", [1, 0], 1)
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))
    # The log names synchronisations at most once a second, the diagnostics count all of them.
    rig.until(lambda: rig.status("comparison").message == "healthy")
    assert {v.key: v.value for v in rig.status("comparison").values}["synchronisations"] == "2"
    log = capfd.readouterr().err
    reported = [line for line in log.splitlines() if "ANGLE_MISMATCH" in line]
    assert len(reported) == 1, reported
    assert f"not healthy: {named}" in reported[0]


def test_tolerances_are_parameters() -> None:
    with Rig(position_tolerance=1e-4, unhealthy_after=0.0, healthy_after=0.0) as rig:
        rig.board.run(0.1)
        rig.until(lambda: rig.last("/twin/healthy"))
        rig.board.enable_axes()
        rig.board.move([5.0, -5.0])
        rig.caught_up()
        healths = [m.data for m in rig.messages["/twin/healthy"]]
        assert len(healths) >= 4


def test_a_disconnected_board_makes_the_twin_unhealthy(rig: Rig) -> None:
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))
    rig.link.publish(DiagnosticStatus(level=DiagnosticStatus.ERROR, message="gone"))
    rig.until(lambda: rig.last("/twin/healthy") is False)
    rig.until(lambda: rig.status("comparison").message == "the board is not connected")
    rig.link.publish(DiagnosticStatus(level=DiagnosticStatus.OK))
    rig.board.run(0.7)
    rig.until(lambda: "configuration unknown" in rig.last("/twin/state"))
    rig.tuning.publish(Int64MultiArray())
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))


def test_another_board_is_not_compared(rig: Rig) -> None:
    publisher = rig.user.create_publisher(String, topics.RUN_INFO, latched_qos())
    publisher.publish(String(data=RunInfo(board={"name": "servo/mine", "hardware": "mine"}).text()))
    rig.board.run(0.7)
    rig.until(lambda: "'mine' is not the board" in rig.last("/twin/state"))
    assert not rig.messages["/twin/residual"]
    publisher.publish(String(data=RunInfo(board={"name": "servo", "hardware": CATALOGUE.board.name}).text()))
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))


def test_missing_telemetry_makes_the_twin_unhealthy(rig: Rig) -> None:
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))
    rig.until(lambda: rig.last("/twin/healthy") is False)
    rig.until(lambda: rig.status("comparison").message == "no telemetry from /servo")


def test_commands_do_not_replace_missing_telemetry(rig: Rig) -> None:
    """Applied commands do not reset the time-out of the telemetry."""
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))

    def silent() -> bool:
        rig.add_command(AppliedCommand("cmd.position", rig.board.real.tick, (0, 0), 3))
        return bool(rig.status("comparison").message == "no telemetry from /servo")

    rig.until(silent)
    assert rig.last("/twin/healthy") is False


def test_resync_service_answers_at_once(rig: Rig) -> None:
    rig.board.run(0.3)
    rig.caught_up()
    future = rig.resync.call_async(Trigger.Request())
    rig.until(future.done)
    assert future.result().success
    assert "at rest" in future.result().message
    rig.board.run(0.3)
    rig.caught_up()
    rig.until(lambda: any(v.key == "synchronisations" and v.value == "2" for v in rig.status("comparison").values))


OTHERS = ("param.features[0]=SPEED_FORWARD+ANTI_WINDUP", "param.speed_limit=60,90", "param.i_q_limit=2.0,2.5")


def test_nothing_is_compared_before_the_configuration_of_the_board_is_known() -> None:
    """A board with another configuration than that of the firmware would differ until it has been read."""
    with Rig(configured=False) as rig:
        rig.board.run(0.7)
        rig.until(lambda: rig.last("/twin/state") == "SYNCHRONISING configuration unknown: no message on /servo/tuning")
        rig.caught_up()
        assert not rig.last("/twin/healthy")
        assert not rig.messages["/twin/residual"]
        rig.tuning.publish(Int64MultiArray())
        rig.board.run(0.7)
        rig.until(lambda: rig.last("/twin/healthy"))
        assert rig.messages["/twin/residual"]


def test_status_reports_unknown_parameters_when_the_boards_differ(rig: Rig) -> None:
    rig.board.set_parameters(*OTHERS, report=False)
    rig.board.enable_axes()
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))
    rig.board.move([5.0, -5.0], 0.4)
    rig.until(lambda: "no message on /servo/parameters" in rig.status("comparison").message)
    assert "differs by" in rig.status("comparison").message


def test_parameters_of_another_version_are_reported(rig: Rig) -> None:
    rig.board_parameters.publish(snapshot_message(["param.warp"], [[8.0]]))
    rig.until(lambda: "the names belong to another version" in rig.status("comparison").message)
    assert rig.status("comparison").level == b"\x01"
    rig.board.set_parameters()
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))


def test_malformed_messages_are_ignored(rig: Rig) -> None:
    rig.snapshot.publish(Float64MultiArray(data=[1.0, 2.0]))
    rig.applied.publish(Int64MultiArray(data=[1]))
    rig.snapshot.publish(snapshot_message(["tick"], [[8.0]]))
    rig.until(lambda: "the snapshot has no" in rig.last("/twin/state"))
    rig.board.run(0.7)
    rig.until(lambda: rig.last("/twin/healthy"))


@pytest.mark.parametrize(
    ("parameters", "reported"),
    [
        ({"plant": "/nowhere/p.toml"}, "plant: /nowhere/p.toml: No such file or directory; correct the path"),
        ({"thresholds": "/nowhere/t.toml"}, "thresholds: /nowhere/t.toml: No such file or directory; correct the path"),
        ({"seed": -1}, "seed"),
        ({"position_tolerance": "small"}, "position_tolerance"),
    ],
)
def test_invalid_parameters_are_refused(parameters: dict[str, Any], reported: str) -> None:
    with pytest.raises(ParameterError, match=reported):
        Rig(**parameters)


def test_main_reports_an_invalid_parameter_in_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--ros-args", "-p", "plant:=/nowhere.toml"]) == 2
    error = capfd.readouterr().err
    assert "servo_twin: parameter plant" in error
    assert "Traceback" not in error
