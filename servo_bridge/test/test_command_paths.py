"""Reports of ``servo-command`` about a path before the motion."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from servo_bridge.command_paths import run_path
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.files import read_waypoints
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import Joint
from servo_msgs_py.robot_description import Motor

CATALOGUE = Catalogue.load()
RAW = {v.name: [0] * v.count for v in parameters(CATALOGUE)}
for _name, _value in (("speed_limit", 300.0), ("acceleration_limit", 4000.0), ("i_q_limit", 4.0)):
    RAW[f"param.{_name}"] = [CATALOGUE[f"param.{_name}"].to_raw(_value)] * 2
MOTORS = [Motor(0.05, 8.0e-6), Motor(0.04, 2.0e-5)]


def user_of(joint: Joint, motors: list[Motor], position: float = 0.0) -> SimpleNamespace:
    """Client of a board whose first joint is at a position [rad]."""
    return SimpleNamespace(
        positions=lambda: {"axis1": position, "axis2": 0.0},
        joints=lambda: [joint, Joint("axis2")],
        motors=lambda: motors,
        parameters=lambda: RAW,
    )


def not_followed(_message: object, _duration: float) -> str:
    raise AssertionError


def report(motors: list[Motor], gear_ratio: float = 1.0, acceleration: float = 1000.0) -> str:
    """Report about a sine with an acceleration amplitude of the joint [rad/s^2]."""
    user = user_of(Joint("axis1", gear_ratio), motors)
    omega = 2.0 * 3.141592653589793 * 5.0
    options = {"joint": "axis1", "amplitude": acceleration / omega**2, "frequency": 5.0, "duration": 4.0}
    args = argparse.Namespace(verb="sine", dry_run=True, **options)
    return run_path(user, args, not_followed)


@pytest.mark.parametrize("gear_ratio", [1.0, 3.0])
def test_dry_run_prints_the_current_of_the_acceleration(gear_ratio: float) -> None:
    printed = re.search(r"rad/s, (\S+) of \S+ rad/s\^2, with (\S+) of 4 A", report(MOTORS, gear_ratio))
    assert printed is not None
    acceleration, current = map(float, printed.groups())
    assert current == pytest.approx(acceleration * gear_ratio * 8.0e-6 / 0.05, rel=0.01)
    assert acceleration == pytest.approx(1000.0, rel=0.2)


@pytest.mark.parametrize(("wraps", "end"), [(False, "-3 rad"), (True, "3.28319 rad")])
def test_a_joint_that_wraps_moves_by_the_shorter_way(tmp_path: Path, wraps: bool, end: str) -> None:
    user = user_of(Joint("axis1", wraps=wraps), MOTORS, position=3.0)
    move = argparse.Namespace(verb="move", dry_run=True, targets=[("axis1", -3.0)], time=1.0)
    file = tmp_path / "path.csv"
    file.write_text("time,axis1\n1.0,-3.0\n")
    follow = argparse.Namespace(verb="follow", dry_run=True, waypoints=read_waypoints(file))
    for args in (move, follow):
        assert f"axis1: to {end}" in run_path(user, args, not_followed)


def test_a_path_of_a_joint_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("time,elbow\n1.0,-3.0\n")
    follow = argparse.Namespace(verb="follow", dry_run=True, waypoints=read_waypoints(tmp_path / "path.csv"))
    with pytest.raises(TrajectoryError, match="joint 'elbow' does not exist; the joints are axis1"):
        run_path(user_of(Joint("axis1"), MOTORS, position=3.0), follow, not_followed)


def test_current_of_an_unknown_motor_is_not_reported() -> None:
    assert "with an unknown current of 4 A" in report([])


def test_a_path_beyond_the_torque_of_the_current_limit_is_refused() -> None:
    with pytest.raises(TrajectoryError, match="torque"):
        report([Motor(0.05, 8.0e-4), MOTORS[1]], acceleration=400.0)
