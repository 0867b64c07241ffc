"""Form of incoming commands: every way to get it wrong has its own sentence."""

from __future__ import annotations

import math
from typing import Any

import pytest
from servo_bridge.setpoints import Mode, Rejected, from_array, from_joint_command, from_single

pytestmark = pytest.mark.realtime

JOINTS = ("axis1", "axis2")


def joint_command(**fields: Any) -> Any:
    arguments = {"names": [], "position": [], "velocity": [], "effort": []} | fields
    return from_joint_command("joint_commands", JOINTS, **arguments)


@pytest.mark.parametrize(
    ("field", "mode"), [("position", Mode.POSITION), ("velocity", Mode.SPEED), ("effort", Mode.TORQUE)]
)
def test_the_filled_array_chooses_the_mode(field: str, mode: Mode) -> None:
    request = joint_command(names=["axis2", "axis1"], **{field: [2.0, 1.0]})
    assert (request.mode, dict(request.values)) == (mode, {0: 1.0, 1: 2.0})


def test_one_joint_leaves_the_other_alone() -> None:
    assert dict(joint_command(names=["axis2"], position=[3.0]).values) == {1: 3.0}


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"names": ["elbow"], "position": [1.0]}, "joint 'elbow' does not exist; the joints are axis1, axis2"),
        ({"names": [], "position": [1.0, 2.0]}, "name is empty; name the joints"),
        ({"names": ["axis1", "axis1"], "position": [1.0, 2.0]}, "named twice"),
        (
            {"names": ["axis1", "axis2"], "position": [1.0]},
            "position has 1 values for 2 names; give one",
        ),
        ({"names": ["axis1"], "velocity": [1.0, 2.0]}, "velocity has 2 values for 1 names"),
        ({"names": ["axis1"]}, "fill exactly one of position, velocity and effort; filled: none"),
        ({"names": ["axis1"], "position": [1.0], "effort": [0.0]}, "filled: position and effort"),
        ({"names": ["axis1", "axis2"], "position": [1.0, math.nan]}, "position of axis2 is nan; send a finite number"),
        ({"names": ["axis1"], "effort": [-math.inf]}, "effort of axis1 is -inf"),
    ],
)
def test_wrong_joint_commands(fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(Rejected) as caught:
        joint_command(**fields)
    assert str(caught.value).startswith("joint_commands: ")
    assert sentence in str(caught.value)


def test_array_in_joint_order() -> None:
    request = from_array("commands", JOINTS, [1.0, 2.0])
    assert (request.mode, dict(request.values)) == (Mode.POSITION, {0: 1.0, 1: 2.0})


@pytest.mark.parametrize("data", [[], [1.0], [1.0, 2.0, 3.0]])
def test_wrong_array_lengths(data: list[float]) -> None:
    with pytest.raises(Rejected, match=rf"commands: {len(data)} values given, 2 expected; .*\(axis1, axis2\)"):
        from_array("commands", JOINTS, data)


def test_no_number_in_array_or_single() -> None:
    with pytest.raises(Rejected, match="position of axis1 is inf"):
        from_array("commands", JOINTS, [math.inf, 0.0])
    with pytest.raises(Rejected, match="axis2/position: position is nan"):
        from_single("axis2/position", 1, math.nan)
    assert dict(from_single("axis2/position", 1, 4.0).values) == {1: 4.0}
