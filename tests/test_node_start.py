"""Start of nodes: refused parameters leave no resources; names and namespaces."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_dict_from_yaml_file, parameter_value_to_python
from servo_bridge.node import ServoBridge
from servo_bridge.parameters import PARAMETERS as BRIDGE_PARAMETERS
from servo_msgs_py.runtime.node_shell import NameTakenError, claim_name, full_name, run
from servo_msgs_py.runtime.parameters import ParameterError, Spec, declare, ros_parameter_file, spec
from servo_twin.node import PARAMETERS as TWIN_PARAMETERS
from servo_twin.node import ServoTwin
from servo_twin.viewer_node import PARAMETERS as VIEWER_PARAMETERS
from servo_twin.viewer_node import ServoViewer

from servo_bridge import command

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).resolve().parents[1]


def bridge(**node_arguments: Any) -> Node:
    return ServoBridge(lambda work: work(), **node_arguments)


@pytest.mark.parametrize(
    ("node", "parameter", "value", "name"),
    [
        (bridge, "joints", ["one"], "servo_bridge"),
        (ServoTwin, "seed", -1, "servo_twin"),
        (ServoViewer, "web", False, "servo_viewer"),
    ],
)
def test_refused_node_leaves_no_resources(node: Callable[..., Node], parameter: str, value: Any, name: str) -> None:
    """It is destroyed at once, although the exception is still referenced."""
    context = rclpy.Context()
    rclpy.init(context=context)
    try:
        observer = Node("observer", context=context)
        with pytest.raises(ParameterError) as refused:
            node(context=context, parameter_overrides=[Parameter(parameter, value=value)])
        names = observer.get_node_names()
        assert "observer" in names
        assert name not in names, refused
    finally:
        rclpy.shutdown(context=context)


@pytest.fixture
def context() -> Iterator[rclpy.Context]:
    context = rclpy.Context()
    rclpy.init(context=context)
    yield context
    rclpy.try_shutdown(context=context)


def topics_heard(node: Node) -> set[str]:
    return {name for name, _ in node.get_subscriber_names_and_types_by_node(node.get_name(), node.get_namespace())}


@pytest.mark.parametrize(
    ("namespace", "board", "snapshot"),
    [
        ("/twin", None, "/servo/snapshot"),
        ("/robotA/twin", None, "/robotA/servo/snapshot"),
        ("/robotA/twin", "drive/left", "/robotA/drive/left/snapshot"),
        ("/robotA/twin", "/servo/", "/servo/snapshot"),
    ],
)
def test_twin_follows_the_board_in_its_namespace(
    context: rclpy.Context, namespace: str, board: str | None, snapshot: str
) -> None:
    overrides = [] if board is None else [Parameter("board_namespace", value=board)]
    arguments = ["--ros-args", "-r", f"__ns:={namespace}"]
    twin = ServoTwin(context=context, cli_args=arguments, parameter_overrides=overrides)
    try:
        heard = topics_heard(twin)
    finally:
        twin.shutdown()
    assert {name for name in heard if name.endswith("/snapshot")} == {snapshot}


@pytest.mark.parametrize(("namespace", "expected"), [("/", "/{}/snapshot"), ("/robotA", "/robotA/{}/snapshot")])
def test_a_viewer_shows_board_and_twin_of_its_namespace(
    context: rclpy.Context, tmp_path: Path, namespace: str, expected: str
) -> None:
    overrides = [Parameter("web", value=False), Parameter("record", value=str(tmp_path / "view.rrd"))]
    arguments = ["--ros-args", "-r", f"__ns:={namespace}"]
    viewer = ServoViewer(context=context, cli_args=arguments, parameter_overrides=overrides)
    try:
        heard = topics_heard(viewer)
    finally:
        viewer.shutdown()
    snapshots = {name for name in heard if name.endswith("/snapshot")}
    assert snapshots == {expected.format("servo"), expected.format("twin")}


def test_two_boards_have_diagnostics_of_different_names(context: rclpy.Context) -> None:
    names = []
    for robot in ("robotA", "robotB"):
        node = ServoTwin(context=context, cli_args=["--ros-args", "-r", f"__ns:=/{robot}/twin"])
        names.append(full_name(node))
        node.shutdown()
    assert names == ["robotA/twin/servo_twin", "robotB/twin/servo_twin"]


def test_second_node_of_the_same_name_is_refused_until_the_first_ends(context: rclpy.Context) -> None:
    first = ServoTwin(context=context)
    other = rclpy.Context()
    rclpy.init(context=other)
    try:
        with pytest.raises(
            NameTakenError, match=r"a node /twin/servo_twin is already running in ROS domain \d+ .*__ns:="
        ):
            ServoTwin(context=other)
        ServoTwin(context=other, cli_args=["--ros-args", "-r", "__ns:=/b/twin"]).shutdown()
        first.shutdown()
        rclpy.shutdown(context=context)
        ServoTwin(context=other).shutdown()
    finally:
        rclpy.shutdown(context=other)


@pytest.mark.parametrize(
    ("module", "taken"), [("servo_bridge", "servo/servo_bridge"), ("servo_twin", "twin/servo_twin")]
)
def test_second_program_with_the_same_name_ends_with_a_message(context: rclpy.Context, module: str, taken: str) -> None:
    holder = Node(taken.split("/")[1], namespace=taken.split("/")[0], context=context)
    claim_name(holder)
    command = [sys.executable, "-c", f"import sys; from {module}.node import main; sys.exit(main())"]
    second = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert second.returncode == 1, second.stderr
    assert second.stderr.startswith(f"{module}: a node /{taken} is already running"), second.stderr
    assert len(second.stderr.splitlines()) == 1
    holder.destroy_node()


class Finished(Node):  # type: ignore[misc]
    """A node that ends at once."""

    failure, finished = "", True

    def __init__(self) -> None:
        super().__init__("finished")
        declare(self, {"port": spec("", "text"), "baud": spec(1, "number")})

    def shutdown(self) -> None:
        self.destroy_node()


GIVEN = ["--ros-args", "-p", "prot:=1", "-p", "xyz:=2", "-p", "baud:=3", "-p", "use_sim_time:=false"]


@pytest.mark.parametrize(
    ("start", "unknown"),
    [
        (lambda: run("finished", "", {}, lambda _: Finished(), GIVEN), ["did you mean port?", "none has a similar"]),
        (lambda: command.main(["--wait", "0", "state", *GIVEN]), ["none has a similar"] * 3),
    ],
)
def test_unknown_parameters_are_named(
    start: Callable[[], int], unknown: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    """Nodes and programs that send commands; rclpy would ignore them silently."""
    start()
    lines = [line for line in capfd.readouterr().err.splitlines() if "does not exist and is ignored" in line]
    assert len(lines) == len(unknown)
    for line in lines:
        assert any(text in line for text in unknown)
    assert ("parameter baud" in "".join(lines)) == (len(lines) == 3)


CONFIGURATIONS = [
    ("servo_bridge", "servo_bridge.yaml", BRIDGE_PARAMETERS),
    ("servo_twin", "servo_twin.yaml", TWIN_PARAMETERS),
    ("servo_twin", "servo_viewer.yaml", VIEWER_PARAMETERS),
]


@pytest.mark.parametrize(("package", "name", "parameters"), CONFIGURATIONS)
def test_parameter_files_are_up_to_date(package: str, name: str, parameters: Mapping[str, Spec]) -> None:
    text = (ROOT / package / "config" / name).read_text(encoding="utf-8")
    assert text == ros_parameter_file(name.removesuffix(".yaml"), parameters), "run `make generate`"


@pytest.mark.parametrize(("package", "name", "parameters"), CONFIGURATIONS)
def test_parameter_files_load_with_the_declared_types(package: str, name: str, parameters: Mapping[str, Spec]) -> None:
    """Read as by ``ros2 param load``: YAML 1.1, where 1.5e6 is a string and 1 is not a float."""
    file = ROOT / package / "config" / name
    loaded = parameter_dict_from_yaml_file(str(file), use_wildcard=True)
    found = {key: parameter_value_to_python(parameter.value) for key, parameter in loaded.items()}
    assert found == {key: spec.default for key, spec in parameters.items()}
    assert {key: type(value) for key, value in found.items()} == {k: type(s.default) for k, s in parameters.items()}


@pytest.mark.parametrize(
    ("program", "package", "name"), [("servo_bridge", *CONFIGURATIONS[0][:2]), ("servo_twin", *CONFIGURATIONS[1][:2])]
)
def test_nodes_print_their_parameter_file(program: str, package: str, name: str) -> None:
    command = [sys.executable, "-c", f"import sys; from {program}.node import main; sys.exit(main())"]
    answer = subprocess.run([*command, "--parameter-file"], capture_output=True, text=True, timeout=60)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert answer.stdout == (ROOT / package / "config" / name).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("package", "name"),
    [
        ("servo_bridge", "servo_bridge"),
        ("servo_bridge", "servo-command"),
        ("servo_bridge", "servo-demo"),
        ("servo_twin", "servo_twin"),
        ("servo_twin", "servo_viewer"),
    ],
)
def test_programs_report_missing_rclpy(package: str, name: str, tmp_path: Path) -> None:
    (tmp_path / "rclpy.py").write_text("raise ModuleNotFoundError(\"No module named 'rclpy'\", name='rclpy')\n")
    answer = subprocess.run(
        [sys.executable, ROOT / package / "scripts" / name],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert answer.returncode == 1
    assert answer.stdout == ""
    (line,) = answer.stderr.splitlines()
    assert line.startswith(f"{name}: rclpy cannot be imported by ")
    assert "source its setup.bash" in line
