"""The robot description from a parameter file, and the packaged description."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from servo_bridge.description import description_from_file, main
from servo_msgs_py.joints import joint_names
from servo_msgs_py.robot_description import joints_of

PACKAGE = Path(__file__).resolve().parents[1]


def test_packaged_description_agrees_with_the_defaults() -> None:
    text = (PACKAGE / "urdf" / "servo.urdf").read_text()
    assert text == description_from_file(), "python -m servo_bridge.description > servo_bridge/urdf/servo.urdf"
    assert text == description_from_file(str(PACKAGE / "config" / "servo_bridge.yaml"))


def test_the_shipped_controllers_move_the_joints_of_the_shipped_description() -> None:
    controllers = yaml.safe_load((PACKAGE / "config" / "ros2_controllers.yaml").read_text())
    expected = controllers["/**/joint_trajectory_controller"]["ros__parameters"]
    assert expected["joints"] == joint_names(joints_of(description_from_file()))
    assert set(expected["constraints"]) >= set(expected["joints"])
    assert set(expected["command_interfaces"]) == {"position", "velocity"}
    for joint in joints_of(description_from_file()):
        tolerance = expected["constraints"][joint.name]["trajectory"]  # 0.1 s, ros2_control.md
        assert tolerance == pytest.approx(0.1 * joint.limits.velocity_max, abs=0.2)


def test_joints_and_topics_follow_the_file_and_the_namespace(tmp_path: Path) -> None:
    file = tmp_path / "my.yaml"
    file.write_text("/**:\n  ros__parameters:\n    joints: [lift, pan]\n    direction: [-1, 1]\n")
    text = description_from_file(str(file), "robotA")
    assert [(joint.name, joint.direction) for joint in joints_of(text)] == [("lift", -1), ("pan", 1)]
    assert "/robotA/servo/joint_commands" in text


@pytest.mark.parametrize(
    ("content", "message"),
    [("direction: [3, 1]", "direction of axis1 is 3"), ("joints: [a, a]", "parameter joints"), (None, "No such file")],
)
def test_invalid_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | None, message: str
) -> None:
    file = tmp_path / "my.yaml"
    if content is not None:
        file.write_text(f"/**:\n  ros__parameters:\n    {content}\n")
    assert main(["--params", str(file)]) == 2
    assert message in capsys.readouterr().err
