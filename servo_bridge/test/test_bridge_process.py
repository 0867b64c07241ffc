"""The bridge as a process of its own, on a real pty with a fake board: commands, trouble with the port, signals."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import rclpy
from bridge_rig import DOMAIN
from fake_port import FakePort
from fake_servo import FakeServo
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from servo_bridge.node import main
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.convert import AppliedCommand, applied_from_message
from servo_msgs_py.runtime.end_with_parent import bound_to_us
from servo_msgs_py.runtime.qos import command_qos, latched_qos, telemetry_qos
from std_msgs.msg import Bool, Float64, Float64MultiArray, String
from std_srvs.srv import SetBool

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

CATALOGUE = Catalogue.load()
_NODE = "import sys; from servo_bridge.node import main; sys.exit(main())"


class Spinning(FakeServo):
    """A board whose axes spin as soon as they are enabled, and stop as soon as they are not."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        note = self.on_write
        self.put("axis1.torque_constant", 1000)
        self.put("axis2.torque_constant", 1000)
        self._show(0)

        def written(address: int, data: bytes) -> None:
            assert note is not None
            note(address, data)
            if self.written[-1][0] == "cmd.enable":
                self._show(data[0])

        self.on_write = written

    def _show(self, enabled: int) -> None:
        for axis in ("axis1", "axis2"):
            self.put(f"{axis}.state", 3 if enabled else 2)
            self.put(f"{axis}.substate", 3 if enabled else 0)

    def command_writes(self) -> list[tuple[str, int, bytes]]:
        return [entry for entry in self.written if entry[0].startswith("cmd.")]


class Bridge:
    """The process and a user that listens to it."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.log_file = folder / "log"
        environment = dict(os.environ, ROS_DOMAIN_ID=str(DOMAIN), PYTHONUNBUFFERED="1")
        with self.log_file.open("w") as output:
            self.process = subprocess.Popen(
                bound_to_us([sys.executable, "-c", _NODE, *arguments]),
                stdout=output,
                stderr=output,
                env=environment,
            )
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.user = Node("user", namespace="servo", context=self.context)
        self.executor.add_node(self.user)
        self.seen: dict[str, list[Any]] = {}
        self._listen(topics.STATE, String, latched_qos())
        self._listen(topics.ARMED, Bool, latched_qos())
        self._listen(topics.JOINT_STATES, JointState, telemetry_qos())
        self._listen(topics.COMMANDS_APPLIED, Float64MultiArray, telemetry_qos())
        self.position = self.user.create_publisher(Float64, "axis1/position", command_qos())
        self.enable_client = self.user.create_client(SetBool, topics.ENABLE)

    def __enter__(self) -> Bridge:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(10)
        self.executor.remove_node(self.user)
        self.user.destroy_node()
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)

    def _listen(self, name: str, kind: Any, qos: Any) -> None:
        self.seen[name] = []
        self.user.create_subscription(kind, name, self.seen[name].append, qos)

    def until(self, condition: Callable[[], object], timeout: float = 20.0) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, f"not within {timeout} s; log:\n{self.log()}"
            assert self.process.poll() is None, f"the bridge has ended; log:\n{self.log()}"
            self.executor.spin_once(timeout_sec=0.02)

    def log(self) -> str:
        return self.log_file.read_text()

    def errors(self) -> list[str]:
        return re.findall(r"\[ERROR\] \[[0-9.]+\] \[[^]]+\]: (.*)", self.log())

    def state(self) -> str:
        return self.seen[topics.STATE][-1].data if self.seen[topics.STATE] else ""

    def armed(self) -> bool:
        return bool(self.seen[topics.ARMED]) and self.seen[topics.ARMED][-1].data

    def applied(self) -> list[AppliedCommand]:
        """What the user commanded. The stop with which the bridge takes over may come before this node listens."""
        applied = [applied_from_message(message) for message in self.seen[topics.COMMANDS_APPLIED]]
        return [each for each in applied if each.variable != "cmd.quick_stop"]

    def enable(self) -> None:
        self.until(self.enable_client.service_is_ready)
        future = self.enable_client.call_async(SetBool.Request(data=True))
        self.until(future.done)
        assert future.result().success, future.result().message
        self.until(self.armed)

    def change(self, transition: str) -> None:
        """As ``ros2 lifecycle set``."""
        client = self.user.create_client(ChangeState, "servo_bridge/change_state")
        self.until(client.service_is_ready)
        future = client.call_async(ChangeState.Request(transition=Transition(label=transition)))
        self.until(future.done)
        assert future.result().success

    def end(self, number: int = signal.SIGINT) -> int:
        self.process.send_signal(number)
        return self.process.wait(15)


def port_arguments(port: FakePort) -> list[str]:
    return ["--ros-args", "-p", f"port:={port.path}"]


@pytest.fixture
def board(tmp_path: Path) -> Iterator[tuple[Spinning, FakePort]]:
    servo = Spinning()
    with FakePort(tmp_path / "tty", servo) as port:
        yield servo, port


def test_from_topic_to_board_and_off_at_the_end(board: tuple[Spinning, FakePort], tmp_path: Path) -> None:
    """With the committed parameter file."""
    servo, port = board
    file = Path(__file__).resolve().parents[1] / "config" / "servo_bridge.yaml"
    with Bridge(tmp_path, "--ros-args", "--params-file", str(file), "-p", f"port:={port.path}") as bridge:
        bridge.until(lambda: bridge.state() == "axis1=STOP axis2=STOP")
        bridge.enable()
        bridge.until(bridge.position.get_subscription_count)
        bridge.position.publish(Float64(data=CATALOGUE["cmd.position"].lsb * 1234))
        bridge.until(lambda: len(bridge.applied()) >= 3)
        assert servo.command_writes() == [
            ("cmd.enable", 0, b"\x01\0\x01\0"),
            ("cmd.mode", 0, b"\0\0"),
            ("cmd.position", 0, (1234).to_bytes(4, "little")),
        ]
        applied = bridge.applied()
        assert [(a.variable, a.mask) for a in applied] == [("cmd.enable", 3), ("cmd.mode", 1), ("cmd.position", 1)]
        assert applied[0].tick < applied[1].tick < applied[2].tick
        bridge.until(lambda: bridge.seen[topics.JOINT_STATES])
        assert len(bridge.seen[topics.JOINT_STATES][-1].position) == 2
        assert bridge.end(signal.SIGTERM) == 0
        assert servo.command_writes()[-1] == ("cmd.enable", 0, b"\0\0\0\0")
        assert "Traceback" not in bridge.log()


def test_the_transition_shutdown_ends_the_program_in_order(board: tuple[Spinning, FakePort], tmp_path: Path) -> None:
    servo, port = board
    with Bridge(tmp_path, *port_arguments(port), "-p", "autostart:=false") as bridge:
        bridge.change("configure")
        bridge.change("activate")
        bridge.until(lambda: bridge.state() == "axis1=STOP axis2=STOP")
        bridge.enable()
        client = bridge.user.create_client(ChangeState, "servo_bridge/change_state")
        bridge.until(client.service_is_ready)
        client.call_async(ChangeState.Request(transition=Transition(label="shutdown")))
        assert bridge.process.wait(15) == 0, bridge.log()
        assert servo.command_writes()[-1] == ("cmd.enable", 0, b"\0\0\0\0")
        assert "Traceback" not in bridge.log()


def stops(servo: FakeServo) -> int:
    """How often the board has been stopped: every attempt to connect begins and ends with it."""
    return [command for command, _ in servo.requests].count(0x30)


def test_the_wrong_board_is_named_once_and_the_node_lives_on(tmp_path: Path) -> None:
    """Others: test_link_trouble.py."""
    servo = FakeServo()
    servo.put("catalogue_hash", CATALOGUE.hash ^ 1)
    with FakePort(tmp_path / "tty", servo) as port, Bridge(tmp_path, *port_arguments(port)) as bridge:
        bridge.until(bridge.errors)
        bridge.until(lambda: "another table of variables" in bridge.state())
        assert "flash the firmware" in bridge.state()
        tried = stops(servo)
        bridge.until(lambda: stops(servo) >= tried + 3)  # two with each attempt
        assert len(bridge.errors()) == 1, bridge.log()
        assert bridge.state().startswith("DISCONNECTED ")
        assert not bridge.armed()
        assert bridge.end() == 0
        assert "Traceback" not in bridge.log()


def test_a_port_that_does_not_exist_is_waited_for(tmp_path: Path) -> None:
    port = FakePort(tmp_path / "later", Spinning())
    try:
        with Bridge(tmp_path, *port_arguments(port)) as bridge:
            bridge.until(lambda: str(port.path) in bridge.state() and bridge.errors())
            port.plug()
            bridge.until(lambda: bridge.state() == "axis1=STOP axis2=STOP")
            assert len(bridge.errors()) == 1, bridge.log()
            assert bridge.end() == 0
    finally:
        port.__exit__(None, None, None)


def test_an_interrupted_demonstration_disables_the_axes(board: tuple[Spinning, FakePort], tmp_path: Path) -> None:
    servo, port = board
    with Bridge(tmp_path, *port_arguments(port)) as bridge:
        bridge.until(lambda: bridge.state() == "axis1=STOP axis2=STOP")
        for number in (signal.SIGINT, signal.SIGTERM):
            servo.written.clear()
            with subprocess.Popen(
                bound_to_us([sys.executable, "-m", "servo_bridge.demo"]),
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                env=dict(os.environ, ROS_DOMAIN_ID=str(DOMAIN)),
            ) as demo:
                try:
                    # The shafts of this board never move, so the first move lasts until it is ended.
                    bridge.until(lambda: any(name == "cmd.position" for name, _, _ in servo.command_writes()))
                    demo.send_signal(number)
                    output, _ = demo.communicate(timeout=20)
                finally:
                    demo.kill()  # or the end of `with` would wait for ever
            assert demo.returncode == 130, output
            assert "disabled: axis1=STOP axis2=STOP" in output
            assert "servo-demo: interrupted" in output
            assert "Traceback" not in output
            assert servo.command_writes()[-1] == ("cmd.enable", 0, b"\0\0\0\0")
        assert bridge.end() == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "joints:=[one]"], "parameter joints"),
        (["--params-file", "/nowhere.yaml"], "nowhere.yaml"),
        (["-p", "nonsense"], "nonsense"),
    ],
)
def test_senseless_arguments_end_with_one_line(
    arguments: list[str], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["--ros-args", *arguments]) == 2
    (line,) = (line for line in capfd.readouterr().err.splitlines() if "[rcl]" not in line)
    assert line.startswith("servo_bridge: ")
    assert words in line
    assert "/src/" not in line
