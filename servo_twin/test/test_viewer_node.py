"""The viewer as a separate process; the test publishes the topics of board and twin."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import JointState
from servo_msgs_py.convert import FAULTS, diagnostic_array, diagnostic_status, joint_state, snapshot_message
from servo_msgs_py.joints import DEFAULT_JOINTS
from servo_msgs_py.rerun_file import RecordingError
from servo_msgs_py.robot_description import describe
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_msgs_py.runtime.qos import latched_qos, telemetry_qos
from servo_msgs_py.runtime.ros_arguments import parameter_arguments
from servo_msgs_py.units import PERIOD_NS
from servo_twin.view import scene
from servo_twin.view.recording import read_scalars, read_texts
from servo_twin.viewer_node import main
from std_msgs.msg import Bool, Float64MultiArray, String
from viewer_rig import CATALOGUE, COLUMNS, EVERY, FAULT, move, stamp, verify

from servo_msgs_py import topics

pytest.importorskip("rerun")
pytestmark = [
    pytest.mark.filterwarnings("ignore:RRD file has no footer"),
    pytest.mark.realtime,
]  # a file that is still being written

DOMAIN = int(os.environ.get("ROS_DOMAIN_ID", "0")) or 20 + os.getpid() % 80
TIMEOUT = 30.0  # [s]
MAIN = "import sys; from servo_twin.viewer_node import main; sys.exit(main())"


def _wait(condition: Callable[[], bool], what: str, seconds: float = TIMEOUT) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"not within {seconds:g} s: {what}"
        time.sleep(0.05)


class ViewerProcess:
    """The process and its output."""

    def __init__(self, folder: Path, **parameters: object) -> None:
        self._log = folder / "log"
        with self._log.open("w") as output:
            self.process = subprocess.Popen(
                with_parent_death_signal([sys.executable, "-c", MAIN, *parameter_arguments(**parameters)]),
                stdout=output,
                stderr=output,
                env=dict(os.environ, ROS_DOMAIN_ID=str(DOMAIN), RERUN_STRICT="1"),
            )

    def text(self) -> str:
        return self._log.read_text()

    def wait_for(self, pattern: str) -> re.Match[str]:
        def there() -> bool:
            assert self.process.poll() is None or re.search(pattern, self.text()), self.text()
            return re.search(pattern, self.text()) is not None

        _wait(there, f"{pattern} in the output:\n{self.text()}")
        found = re.search(pattern, self.text())
        assert found
        return found

    def stop(self, number: signal.Signals) -> int:
        """Exit status after a signal; the process has to end within 5 s."""
        self.process.send_signal(number)
        return self.process.wait(5.0)


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., ViewerProcess]]:
    started: list[ViewerProcess] = []

    def run(**parameters: object) -> ViewerProcess:
        started.append(ViewerProcess(tmp_path, **parameters))
        return started[-1]

    yield run
    for viewer in started:
        if viewer.process.poll() is None:
            viewer.process.kill()
        viewer.process.wait()


Start = Callable[..., ViewerProcess]


class Robot:
    """Publishers of a board and of a twin."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = Node("robot", context=self.context)
        deep, latched = telemetry_qos(500), latched_qos()
        self._made: dict[str, Any] = {
            name: self.node.create_publisher(kind, name, qos)
            for name, kind, qos in (
                ("/servo/snapshot", Float64MultiArray, deep),
                ("/twin/snapshot", Float64MultiArray, deep),
                ("/twin/residual", JointState, deep),
                ("/servo/recording", Float64MultiArray, latched),
                ("/twin/recording", Float64MultiArray, latched),
                ("/twin/residual/recording", Float64MultiArray, latched),
                ("/servo/link", DiagnosticStatus, latched),
                ("/servo/robot_description", String, latched),
                ("/twin/healthy", Bool, latched),
                ("/diagnostics", DiagnosticArray, 10),
            )
        }
        text = describe(DEFAULT_JOINTS, CATALOGUE, commands_topic="/a", states_topic="/b")
        self.publish("/servo/robot_description", String(data=text))
        self.start_ns = self.node.get_clock().now().nanoseconds

    def wait_for_viewer(self, viewer: ViewerProcess) -> None:
        viewer.wait_for("joints: axis1, axis2")
        _wait(lambda: all(p.get_subscription_count() for p in self._made.values()), "subscriptions of the viewer")
        self.start_ns = self.node.get_clock().now().nanoseconds

    def publish(self, topic: str, message: Any) -> None:
        self._made[topic].publish(message)

    def rows(self, topic: str, *, samples: int = 500, **shape: float) -> None:
        table = move(samples=samples, start_ns=self.start_ns, **shape)  # type: ignore[arg-type]
        if topic == "/servo/snapshot":
            words = [COLUMNS.index(f"axis1.{name}") for name in ("state", "substate", "faults")]
            table[-100:, words] = (*FAULT, 1 << 2)
        for k in range(0, samples, 10):
            self.publish(topic, snapshot_message(COLUMNS, table[k : k + 10].tolist()))

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def robot() -> Iterator[Robot]:
    made = Robot()
    yield made
    made.close()


def _points(file: Path, entity: str) -> int:
    """Points of a curve in a file that is still being written."""
    with contextlib.suppress(RecordingError):
        return len(read_scalars(file, entity)[0])
    return 0


def _wait_points(file: Path, expected: dict[str, int]) -> None:
    seen: dict[str, int] = {}

    def there() -> bool:
        seen.update({entity: _points(file, entity) for entity in expected})
        return seen == expected

    try:
        _wait(there, "points")
    except AssertionError:
        assert seen == expected


def _texts(file: Path, source: str) -> list[str]:
    """Lines of a log in a file that is still being written."""
    with contextlib.suppress(RecordingError):
        return [text for _, text in read_texts(file, f"/log/{source}")]
    return []


BOARD_SPEED = scene.series_entity(1, "speed", scene.BOARD)
TWIN_SPEED = scene.series_entity(1, "speed", scene.TWIN)
RESIDUAL = scene.residual_entity(0, "position")


def test_published_data_are_in_the_file_after_sigterm(start: Start, robot: Robot, tmp_path: Path) -> None:
    file = tmp_path / "new" / "run.rrd"
    viewer = start(record=file, web=False)
    viewer.wait_for("recording to ")
    robot.wait_for_viewer(viewer)
    robot.publish("/servo/link", DiagnosticStatus(level=DiagnosticStatus.OK))
    robot.publish("/twin/healthy", Bool(data=True))
    robot.rows("/servo/snapshot")
    _wait_points(file, {BOARD_SPEED: 500})
    robot.rows("/twin/snapshot", lag=0.01)
    for k in range(500):
        when = stamp(EVERY * k, robot.start_ns)
        robot.publish("/twin/residual", joint_state(["left", "right"], when, [0.25, 0.5], [1.0, 1.0], [0.0, 0.0]))
    names = ["tick", "axis1.i_a", topics.BURST_TIME, *topics.STAMP_COLUMNS]
    points = [[float(EVERY * 50 + k), 0.1 * k, 0.0, 0.0, 0.0] for k in range(100)]
    robot.publish("/servo/recording", snapshot_message(names, points))
    same = [[*row[:1], row[1] - 0.5, *row[2:]] for row in points]
    robot.publish("/twin/recording", snapshot_message(names, same))
    rest = [[*row[:1], 0.5 if k < 60 else float("nan"), *row[2:]] for k, row in enumerate(points)]
    robot.publish("/twin/residual/recording", snapshot_message(names, rest))
    trouble = diagnostic_status("servo_bridge: link", DiagnosticStatus.WARN, "2 timeouts", "board", {})
    faulted = diagnostic_status(
        "servo_bridge: left", DiagnosticStatus.ERROR, "known", "board", {FAULTS: "OVER_CURRENT"}
    )
    robot.publish("/diagnostics", diagnostic_array(stamp(EVERY, robot.start_ns), [faulted, trouble]))
    burst, burst_of_twin, burst_residual = (
        scene.burst_entity("axis1.i_a", source) for source in (scene.BOARD, scene.TWIN, scene.RESIDUAL)
    )
    bursts = {burst: 100, burst_of_twin: 100, burst_residual: 100}
    _wait_points(file, {BOARD_SPEED: 500, TWIN_SPEED: 500, RESIDUAL: 500, **bursts})
    _wait(lambda: all(_texts(file, name) for name in ("diagnostics", "link", "twin")), "all lines of the log")
    assert viewer.stop(signal.SIGTERM) == 0
    assert "Traceback" not in viewer.text()
    result = verify(file)
    assert result.returncode == 0, result.stderr
    board, twin = read_scalars(file, BOARD_SPEED), read_scalars(file, TWIN_SPEED)
    assert board[0] == pytest.approx(twin[0], abs=1e-6)
    times, currents = read_scalars(file, burst)
    assert times[0] == pytest.approx(board[0][50], abs=1e-6), "at its tick on the time axis of the telemetry"
    assert np.diff(times) == pytest.approx(np.full(99, PERIOD_NS * 1e-9), abs=2e-9)
    assert currents == pytest.approx(0.1 * np.arange(100))
    assert read_scalars(file, burst_of_twin)[0] == pytest.approx(times)
    assert read_scalars(file, burst_of_twin)[1] == pytest.approx(currents - 0.5)
    assert read_scalars(file, burst_residual)[0] == pytest.approx(times)
    assert read_scalars(file, burst_residual)[1] == pytest.approx([0.5] * 60 + [np.nan] * 40, nan_ok=True)
    assert set(read_scalars(file, RESIDUAL)[1]) == {0.25}
    assert read_scalars(file, RESIDUAL)[0] == pytest.approx(board[0], abs=1e-6)
    states = [state for _, state in read_texts(file, scene.state_entity("axis1"), "StateChange:state")]
    assert states == ["STOP", "RUN/SPIN", "FAULT"]
    assert [state for _, state in read_texts(file, scene.state_entity("twin"), "StateChange:state")] == ["HEALTHY"]
    assert any("OVER_CURRENT" in text and "clear the fault" in text for _, text in read_texts(file, "/log/axis1"))
    assert [text for _, text in read_texts(file, "/log/diagnostics")] == ["diagnostics: servo_bridge: link: 2 timeouts"]


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (["web:=false"], "no output: set parameter record"),
        (["web:=false", "record:=/dev/null/run.rrd"], "/dev/null/run.rrd cannot be written"),
        (["web_port:=80"], "parameter web_port"),
        (["web:=perhaps"], "parameter web"),
    ],
)
def test_invalid_parameters_end_the_viewer_with_one_message(
    parameters: list[str], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["--ros-args", *(word for parameter in parameters for word in ("-p", parameter))]) == 2
    (line,) = (line for line in capfd.readouterr().err.splitlines() if not line.startswith("["))
    assert line.startswith("servo_viewer: ")
    assert message in line
