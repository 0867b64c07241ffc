"""Limits of paths: the tighter of board (in joint units) and joint."""

from __future__ import annotations

import pytest
from servo_bridge.trajectory.check import Limits
from servo_bridge.trajectory_limits import path_limits
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import Joint, JointLimits
from servo_msgs_py.robot_description import Motor

CATALOGUE = Catalogue.load()
VALUES = {
    "param.position_min": -10.0,
    "param.position_max": 30.0,
    "param.speed_limit": 100.0,
    "param.acceleration_limit": 2000.0,
    "param.i_q_limit": 2.0,
}


def limits(*joints: Joint, confined: bool = True) -> list[Limits]:
    raw = {v.name: [0] * v.count for v in parameters(CATALOGUE)}
    raw |= {name: [CATALOGUE[name].to_raw(value)] * 2 for name, value in VALUES.items()}
    flag = CATALOGUE.flag("features", "POSITION_LIMITS").mask
    raw["param.features"] = [flag if confined else 0] * 2
    return path_limits(CATALOGUE, raw, joints, [Motor(0.05, 1e-5), Motor(0.04, 2e-5)])


def test_limits_of_the_board_are_converted_by_a_reversing_gear() -> None:
    arm, wheel = limits(Joint("arm", 10.0, -1, 0.5), Joint("wheel"))
    assert (arm.position_min, arm.position_max) == pytest.approx((0.5 - 3.0, 0.5 + 1.0), abs=1e-3)
    assert (arm.velocity_max, arm.acceleration_max) == pytest.approx((10.0, 200.0), rel=1e-3)
    assert arm.torque_max == pytest.approx(1.0, rel=1e-3)
    assert (wheel.position_min, wheel.position_max) == pytest.approx((-10.0, 30.0), abs=1e-3)
    assert wheel.torque_max == pytest.approx(0.08, rel=1e-3)


def test_tighter_limit_applies() -> None:
    own = JointLimits(-1.0, 20.0, 5.0, 0.3)
    arm, free = limits(Joint("arm", 10.0, -1, 0.5, own), Joint("free", limits=own))
    assert (arm.position_min, arm.position_max) == pytest.approx((-1.0, 1.5), abs=1e-3)
    assert (arm.velocity_max, arm.torque_max) == (5.0, 0.3)
    assert (free.position_min, free.position_max) == (-1.0, 20.0)


def test_no_position_limit_without_the_feature() -> None:
    arm, _ = limits(Joint("arm", 10.0, -1, limits=JointLimits(position_max=7.0)), Joint("wheel"), confined=False)
    assert (arm.position_min, arm.position_max) == (-float("inf"), 7.0)
