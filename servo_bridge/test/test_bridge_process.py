"""The bridge as a process on a real pty with a fake board: errors of the port, and its end."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
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
from servo_bridge.node import main
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_msgs_py.runtime.qos import latched_qos
from servo_msgs_py.runtime.ros_arguments import parameter_arguments
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool

from servo_msgs_py import topics

pytestmark = pytest.mark.realtime

CATALOGUE = Catalogue.load()
_NODE = "import sys; from servo_bridge.node import main; sys.exit(main())"


class Spinning(FakeServo):
    """Board whose axes change to SPIN and STOP at once with cmd.enable."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        note = self.on_write
        self.put("axis1.torque_constant", 1000)
        self.put("axis2.torque_constant", 1000)
        self._show(0)

        def written(address: int, data: bytes) -> None:
            assert note is not None
            note(address, data)
            if self.written and self.written[-1][0] == "cmd.enable":  # the boot token is not among them
                self._show(data[0])

        self.on_write = written

    def _show(self, enabled: int) -> None:
        for axis in ("axis1", "axis2"):
            self.put(f"{axis}.state", 3 if enabled else 2)
            self.put(f"{axis}.substate", 3 if enabled else 0)

    def command_writes(self) -> list[tuple[str, int, bytes]]:
        return [entry for entry in self.written if entry[0].startswith("cmd.")]


class Bridge:
    """The process, and a ROS node that subscribes to its topics."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.log_file = folder / "log"
        environment = dict(os.environ, ROS_DOMAIN_ID=str(DOMAIN), PYTHONUNBUFFERED="1")
        with self.log_file.open("w") as output:
            self.process = subprocess.Popen(
                with_parent_death_signal([sys.executable, "-c", _NODE, *arguments]),
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

    def until(self, condition: Callable[[], object], timeout: float = 45.0) -> None:
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

    def enable(self) -> None:
        self.until(self.enable_client.service_is_ready)
        future = self.enable_client.call_async(SetBool.Request(data=True))
        self.until(future.done)
        assert future.result().success, future.result().message
        self.until(self.armed)

    def change(self, transition: str) -> None:
        """Request a transition, as by ``ros2 lifecycle set``."""
        client = self.user.create_client(ChangeState, "servo_bridge/change_state")
        self.until(client.service_is_ready)
        future = client.call_async(ChangeState.Request(transition=Transition(label=transition)))
        self.until(future.done)
        assert future.result().success


def port_arguments(port: FakePort) -> list[str]:
    return parameter_arguments(port=port.path)


def test_shutdown_transition_ends_the_program(tmp_path: Path) -> None:
    servo = Spinning()
    with (
        FakePort(tmp_path / "tty", servo) as port,
        Bridge(tmp_path, *port_arguments(port), "-p", "autostart:=false") as bridge,
    ):
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
    """Number of quick stops: one at the start and one at the end of each attempt to connect."""
    return [command for command, _ in servo.requests].count(0x30)


def test_missing_port_and_wrong_board_are_reported_once_each(tmp_path: Path) -> None:
    """Other boards: test_link_trouble.py."""
    servo = Spinning()
    servo.put("catalogue_hash", CATALOGUE.hash ^ 1)
    port = FakePort(tmp_path / "later", servo)
    with Bridge(tmp_path, *port_arguments(port)) as bridge:
        bridge.until(lambda: str(port.path) in bridge.state() and bridge.errors())
        with port:
            bridge.until(lambda: "another table of variables" in bridge.state())
            assert "flash the firmware" in bridge.state()
            tried = stops(servo)
            bridge.until(lambda: stops(servo) >= tried + 3)  # two with each attempt
            assert len(bridge.errors()) == 2, bridge.log()
            assert bridge.state().startswith("DISCONNECTED ")
            assert not bridge.armed()
            servo.put("catalogue_hash", CATALOGUE.hash)
            bridge.until(lambda: bridge.state() == "axis1=STOP axis2=STOP")
            assert len(bridge.errors()) == 2, bridge.log()
            bridge.enable()
            bridge.process.send_signal(signal.SIGTERM)
            assert bridge.process.wait(15) == 0
            assert servo.command_writes()[-1] == ("cmd.enable", 0, b"\0\0\0\0")
            assert "Traceback" not in bridge.log()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "joints:=[one]"], "parameter joints"),
        (["--params-file", "/nowhere.yaml"], "nowhere.yaml"),
        (["-p", "nonsense"], "nonsense"),
    ],
)
def test_invalid_arguments_give_a_one_line_error(
    arguments: list[str], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["--ros-args", *arguments]) == 2
    (line,) = (line for line in capfd.readouterr().err.splitlines() if "[rcl]" not in line)
    assert line.startswith("servo_bridge: ")
    assert words in line
    assert "/src/" not in line
