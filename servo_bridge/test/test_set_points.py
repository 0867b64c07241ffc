"""Form of incoming commands: each error has its own message."""

from __future__ import annotations

import math
from typing import Any

import pytest
from servo_bridge.set_points import (
    JointSetPoint,
    Mode,
    Rejected,
    from_array,
    from_joint_command,
    from_single,
    requests_of,
)

JOINTS = ("axis1", "axis2")


def joint_command(names: list[str], interfaces: Any = None, **arrays: list[float]) -> dict[int, JointSetPoint]:
    every: dict[str, list[float]] = {"position": [], "velocity": [], "effort": []} | arrays
    return from_joint_command("joint_commands", JOINTS, names, every, interfaces)


@pytest.mark.parametrize(
    ("field", "mode"), [("position", Mode.POSITION), ("velocity", Mode.SPEED), ("effort", Mode.TORQUE)]
)
def test_the_filled_array_chooses_the_mode(field: str, mode: Mode) -> None:
    points = joint_command(["axis2", "axis1"], **{field: [2.0, 1.0]})
    assert points == {0: JointSetPoint(**{field: 1.0}), 1: JointSetPoint(**{field: 2.0})}
    assert not any(point.streamed for point in points.values())
    (request,) = requests_of("joint_commands", points)
    assert (request.mode, dict(request.values)) == (mode, {0: 1.0, 1: 2.0})


def test_set_point_of_one_joint_does_not_affect_the_other() -> None:
    assert joint_command(["axis2"], position=[3.0]) == {1: JointSetPoint(3.0)}
    assert joint_command(["axis1", "axis2"], position=[math.nan, 3.0]) == {1: JointSetPoint(3.0)}
    assert joint_command(["axis1", "axis2"], position=[math.nan] * 2, velocity=[math.nan] * 2) == {}


def test_a_position_with_velocity_or_effort_is_streamed() -> None:
    points = joint_command(["axis1", "axis2"], position=[1.0, 2.0], velocity=[3.0, math.nan], effort=[0.5, math.nan])
    assert points == {0: JointSetPoint(1.0, 3.0, 0.5), 1: JointSetPoint(2.0)}
    assert [point.streamed for point in points.values()] == [True, False]
    (request,) = requests_of("joint_commands", points)
    assert (request.mode, dict(request.values)) == (Mode.POSITION, {1: 2.0})
    assert joint_command(["axis1"], position=[1.0], effort=[0.2])[0].streamed


def test_joints_may_have_different_modes() -> None:
    points = joint_command(["axis1", "axis2"], position=[1.0, math.nan], velocity=[math.nan, 5.0])
    assert [(request.mode, dict(request.values)) for request in requests_of("joint_commands", points)] == [
        (Mode.POSITION, {0: 1.0}),
        (Mode.SPEED, {1: 5.0}),
    ]


def test_arrays_may_have_values_of_some_joints() -> None:
    interfaces = {"axis1": {"position"}, "axis2": {"velocity"}}
    points = joint_command(["axis1", "axis2"], interfaces, position=[1.0], velocity=[5.0])
    assert points == {0: JointSetPoint(1.0), 1: JointSetPoint(None, 5.0)}
    with pytest.raises(Rejected, match="position has 2 values for 1 names"):
        joint_command(["axis1", "axis2"], interfaces, position=[1.0, 2.0])


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"names": ["elbow"], "position": [1.0]}, "joint 'elbow' does not exist; the joints are axis1, axis2"),
        ({"names": [], "position": [1.0, 2.0]}, "name is empty; write the names of the joints"),
        ({"names": ["axis1", "axis1"], "position": [1.0, 2.0]}, "occurs twice"),
        (
            {"names": ["axis1", "axis2"], "position": [1.0]},
            "position has 1 values for 2 names; write one value per name",
        ),
        ({"names": ["axis1"], "velocity": [1.0, 2.0]}, "velocity has 2 values for 1 names"),
        ({"names": ["axis1"]}, "position, velocity and effort are empty; fill position, velocity or effort"),
        (
            {"names": ["axis1"], "velocity": [1.0], "effort": [0.0]},
            "has a velocity and an effort, but no position",
        ),
        ({"names": ["axis1", "axis2"], "position": [1.0, math.inf]}, "position of axis2 is inf; send a finite number"),
        ({"names": ["axis1"], "effort": [-math.inf]}, "effort of axis1 is -inf"),
    ],
)
def test_wrong_joint_commands_are_refused(fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(Rejected) as caught:
        joint_command(**fields)
    assert str(caught.value).startswith("joint_commands: ")
    assert sentence in str(caught.value)


def test_array_is_in_joint_order() -> None:
    request = from_array("commands", JOINTS, [1.0, 2.0])
    assert (request.mode, dict(request.values)) == (Mode.POSITION, {0: 1.0, 1: 2.0})


@pytest.mark.parametrize("data", [[], [1.0], [1.0, 2.0, 3.0]])
def test_wrong_array_lengths_are_refused(data: list[float]) -> None:
    with pytest.raises(Rejected, match=rf"commands: {len(data)} values given, 2 expected; .*\(axis1, axis2\)"):
        from_array("commands", JOINTS, data)


def test_nan_and_infinity_are_refused() -> None:
    with pytest.raises(Rejected, match="position of axis1 is inf"):
        from_array("commands", JOINTS, [math.inf, 0.0])
    with pytest.raises(Rejected, match="axis2/position: position is nan"):
        from_single("axis2/position", 1, math.nan)
    assert dict(from_single("axis2/position", 1, 4.0).values) == {1: 4.0}
