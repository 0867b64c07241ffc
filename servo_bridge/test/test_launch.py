"""The launch files with the real ``ros2 launch`` of a sourced ROS 2 or of ``make launch-tools``."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from bridge_rig import DOMAIN
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "servo_bridge" / "launch"
TOOLS = Path(sys.prefix) / "ros2launch"
ROS2 = "import sys; from ros2cli.cli import main; sys.exit(main())"
REASON = "no `ros2 launch`: it has no wheel; source a ROS 2, or `make launch-tools`"


class Launch:
    """A ``ros2 launch`` in a separate process group."""

    def __init__(self, folder: Path, file: str, *arguments: str, prefix: Path | None = None) -> None:
        folder.mkdir(exist_ok=True)
        self.log_file = folder / "log"
        python_path = [str(TOOLS), *filter(None, [os.environ.get("PYTHONPATH")])]
        given = os.environ.get("AMENT_PREFIX_PATH", "")
        prefixes = [path for path in (str(prefix or ""), sys.prefix, given) if path]
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(DOMAIN),
            "ROS_LOG_DIR": str(folder / "ros"),
            "PYTHONPATH": os.pathsep.join(python_path),
            "AMENT_PREFIX_PATH": os.pathsep.join(prefixes),
            "PYTHONUNBUFFERED": "1",
        }
        if prefix is not None:
            environment["PATH"] = os.pathsep.join([str(prefix / "bin"), os.environ["PATH"]])
        command = [sys.executable, "-c", ROS2, "launch", str(FOLDER / file), "viewer:=false", *arguments]
        with self.log_file.open("w") as output:
            self.process = subprocess.Popen(
                with_parent_death_signal(command), stdout=output, stderr=output, env=environment
            )

    def log(self) -> str:
        return self.log_file.read_text()

    def until(self, pattern: str, count: int = 1, timeout: float = 60.0) -> list[str]:
        """Wait until a pattern has been printed `count` times; return the matches."""
        deadline = time.monotonic() + timeout
        while len(found := re.findall(pattern, self.log())) < count:
            assert time.monotonic() < deadline, f"no {pattern}; log:\n{self.log()}"
            assert self.process.poll() is None, f"the launch has ended; log:\n{self.log()}"
            time.sleep(0.05)
        return found

    def end(self) -> int:
        """Wait for the end; return the exit status."""
        return self.process.wait(60.0)

    def _bridge(self) -> int:
        return int(re.findall(r"\[servo_bridge-\d+\]: process started with pid \[(\d+)\]", self.log())[-1])

    def kill_bridge(self) -> None:
        os.kill(self._bridge(), signal.SIGKILL)

    def bridge_parameter(self, name: str) -> object:
        """Value in the last parameter file of the bridge that has it."""
        words = Path(f"/proc/{self._bridge()}/cmdline").read_text().split("\0")
        files = [Path(file) for option, file in pairwise(words) if option == "--params-file"]
        values = [section["ros__parameters"] for file in files for section in yaml.safe_load(file.read_text()).values()]
        return next(each[name] for each in reversed(values) if name in each)

    def interrupt(self) -> int:
        """Send Ctrl-C; return the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.end()


Start = Callable[..., Launch]


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Start]:
    """Starts launch files, and ends them at the end of the test."""
    if not TOOLS.is_dir() and importlib.util.find_spec("ros2launch") is None:
        pytest.skip(REASON)
    started: list[Launch] = []

    def start(file: str, *arguments: str, prefix: Path | None = None) -> Launch:
        started.append(Launch(tmp_path / f"launch{len(started)}", file, *arguments, prefix=prefix))
        return started[-1]

    yield start
    for each in started:
        if each.process.poll() is None:
            each.interrupt()


def test_launch_files_give_every_parameter_a_type() -> None:
    """Without one, launch_ros reads the text of an argument as YAML: a port `/dev/tty #1` would be `/dev/tty`."""
    count = 0
    for file in FOLDER.glob("*.launch.py"):
        tree = ast.parse(file.read_text())
        named = {
            node.targets[0].id: node.value
            for node in ast.walk(tree)
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
        }
        for word in (node for node in ast.walk(tree) if isinstance(node, ast.keyword) and node.arg == "parameters"):
            assert isinstance(word.value, ast.List)
            sets = (named.get(each.id) if isinstance(each, ast.Name) else each for each in word.value.elts)
            for value in (value for each in sets if isinstance(each, ast.Dict) for value in each.values):
                count += 1
                assert isinstance(value, ast.Call), f"{file.name}: {ast.unparse(value)}"
                assert ast.unparse(value.func) == "ParameterValue"
                assert "value_type" in [keyword.arg for keyword in value.keywords]
    assert count >= 7


def test_launched_programs_exist_and_only_nodes_get_ros_arguments() -> None:
    tree = ast.parse((FOLDER / "bridge.launch.py").read_text())
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    nodes = set()
    for call in (call for call in calls if getattr(call.func, "id", "") == "Node"):
        words = {word.arg: word.value for word in call.keywords}
        package, executable = (ast.literal_eval(words[name]) for name in ("package", "executable"))
        nodes.add((package, executable))
    programs = {
        tuple(map(ast.literal_eval, call.args))
        for call in calls
        if getattr(call.func, "id", "") == "ExecutableInPackage"
    }
    assert nodes == {("servo_bridge", "servo_bridge"), ("servo_twin", "servo_twin"), ("servo_twin", "servo_viewer")}
    assert programs == {("virtual_board", "servo_twin")}
    for package, executable in [*nodes, *((package, name) for name, package in programs)]:
        assert (ROOT / package / "scripts" / executable).is_file()


def test_launch_refuses_a_second_bridge_and_ends_with_a_killed_one(launch: Start, tmp_path: Path) -> None:
    arguments = ("virtual:=true", "namespace:=robotA")
    first = launch("bridge.launch.py", *arguments, f"port:={tmp_path}/board")
    first.until(r"\[robotA\.servo\.servo_bridge\]: connected to servo at ")
    first.until(r"\[robotA\.twin\.servo_twin\]: following /robotA/servo,")

    second = launch("bridge.launch.py", *arguments, f"port:={tmp_path}/other")
    assert second.end() == 1, second.log()
    assert "servo_bridge: a node /robotA/servo/servo_bridge is already running" in second.log()
    assert first.process.poll() is None

    first.kill_bridge()
    assert first.end() == 1, first.log()
    assert "the bridge has ended with status -9" in first.log()
    assert "virtual_board: stopped after" in first.log()


def test_two_boards_are_followed_by_a_twin_each(launch: Start, tmp_path: Path) -> None:
    ports = f"port_a:={tmp_path}/a", f"port_b:={tmp_path}/b"
    both = launch("two_boards.launch.py", "virtual:=true", *ports)
    for robot, port in (("robotA", "a"), ("robotB", "b")):
        both.until(rf"\[{robot}\.servo\.servo_bridge\]: connected to servo at {tmp_path}/{port}\n")
        both.until(rf"\[{robot}\.twin\.servo_twin\]: following /{robot}/servo,")
        both.until(rf"\[{robot}\.twin\.servo_twin\]: healthy")
    assert both.interrupt() == 0, both.log()
    assert "virtual_board" in both.log()


def test_launch_passes_parameters_and_respawns_the_bridge(launch: Start, tmp_path: Path) -> None:
    parameters = tmp_path / "twin.yaml"
    parameters.write_text("/**:\n  ros__parameters:\n    board_namespace: /elsewhere\n    healthy_after: 99.0\n")
    one = launch(
        "bridge.launch.py", "virtual:=true", f"port:={tmp_path}/board", "respawn:=true", "use_sim_time:=true",
        f"twin_params:={parameters}",
    )  # fmt: skip
    one.until("connected to servo at ")
    one.until("parameter healthy_after")  # out of range, so the message of the twin shows that it has read the file
    one.kill_bridge()
    one.until("connected to servo at ", count=2)
    assert one.interrupt() == 0, one.log()


@pytest.fixture
def control_packages(tmp_path: Path) -> Path:
    """Installation with fake programs of ros2_control that print their arguments and wait for a signal."""
    prefix = tmp_path / "prefix"
    programs = {
        "lib/controller_manager/ros2_control_node": "sleep 600",
        "lib/controller_manager/spawner": "",
        "lib/robot_state_publisher/robot_state_publisher": "sleep 600",
        "bin/ros2": "",
    }
    for name, then in programs.items():
        program = prefix / name
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(f'#!/bin/sh\necho "{program.name} runs with $*"\nexec {then}\n')
        program.chmod(0o755)
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    for package in ("controller_manager", "robot_state_publisher"):
        (index / package).touch()
        (prefix / "share" / package).mkdir()
    return prefix


def test_ros2_control_gets_the_joints_of_the_bridge(launch: Start, tmp_path: Path, control_packages: Path) -> None:
    parameters = tmp_path / "bridge.yaml"
    parameters.write_text("/**:\n  ros__parameters:\n    joints: [lift, pan]\n    gear_ratio: [50.0, 4.0]\n")
    controllers = tmp_path / "ros2_controllers.yaml"
    controllers.write_text("controller_manager:\n  ros__parameters:\n    update_rate: 150\n")
    one = launch(
        "ros2_control.launch.py", "virtual:=true", "baud:=115200", "namespace:=robotA", f"port:={tmp_path}/board",
        f"params:={parameters}", f"controllers:={controllers}", prefix=control_packages,
    )  # fmt: skip
    one.until(r"\[robotA\.servo\.servo_bridge\]: connected to servo at ")
    (files,) = one.until(r"robot_state_publisher runs with .*--params-file (\S+)")
    text = Path(files).read_text()
    assert "/robotA/servo/joint_commands" in text
    assert "mechanical_reduction>50.0<" in text
    (manager,) = one.until(r"ros2_control_node runs with (.*)")
    assert "__ns:=/robotA" in manager
    assert "~/robot_description:=robot_description" in manager
    assert "ros2_controllers.yaml" in manager
    (spawner,) = one.until(r"spawner runs with (.*)")
    assert spawner.startswith("joint_state_broadcaster joint_trajectory_controller --param-file ")
    assert one.log().index("ros2_control_node runs") < one.log().index("spawner runs")
    assert one.bridge_parameter("telemetry_rate") == 150.0, "a state per update"
    one.kill_bridge()
    assert one.end() == 1, one.log()
    assert "the bridge has ended with status -9" in one.log()


def test_bridge_without_autostart_waits_for_transitions(launch: Start, tmp_path: Path) -> None:
    one = launch("bridge.launch.py", f"port:={tmp_path}/board", "twin:=false", "autostart:=false")
    one.until(r"unconfigured; to continue: ros2 lifecycle set /servo/servo_bridge configure")
    assert one.interrupt() == 0, one.log()
    assert "connecting to" not in one.log()
