"""The arm of MuJoCo, moved over ROS by the bridge: its board is at a pseudo-terminal like any other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from chain import FAST_BAUD, Chain, ros_user
from servo_msgs_py.convert import from_stamp
from servo_twin.runs.command import main
from std_msgs.msg import Float64

pytest.importorskip("mujoco", reason="there is no MuJoCo 4 for Python 3.10")

pytestmark = pytest.mark.realtime

GRAVITY = 9.81 * (0.6 * 0.15 + 0.3 * (0.3 + 0.125))
"""Torque at the shoulder of the horizontal arm, elbow straight [N m]."""
FRICTION = 0.05
"""Of the joint [N m]."""
GEAR = 100.0


def test_arm_is_moved_over_ros_and_its_twin_agrees(tmp_path: Path) -> None:
    """The effort on `joint_states` is the weight of the arm. Twin and replay move the same model: no residual."""
    chain = Chain(tmp_path, FAST_BAUD, level="ideal")
    run = tmp_path / "run.mcap"
    with ros_user() as user:
        try:
            chain.twin(seed=5, robot="arm")
            chain.bridge(run_file=str(run))
            user.until(lambda: user.matched() and user.last("/twin/state"), what="no bridge, or no twin")
            chain.board(seed=5, options=["--robot", "arm"])  # last, so that the twin can follow it from its reset
            user.until(user.connected, what="the bridge is not connected")
            user.enable_axes()
            user.position[0].publish(Float64(data=0.25 * np.pi * GEAR))
            user.until(lambda: abs(user.position_of(0) - 0.25 * np.pi * GEAR) < 0.01, what="the arm does not arrive")
            user.wait_board_time(0.3)
            states, residuals = user.messages["/servo/joint_states"], user.messages["/twin/residual"]
            end = from_stamp(states[-1].header.stamp)
            user.until(
                lambda: residuals and from_stamp(residuals[-1].header.stamp) >= end, what="the twin stays behind"
            )
            expected = GRAVITY * np.sin(0.25 * np.pi) / GEAR
            effort = np.mean([message.effort[0] for message in states[-50:]])
            assert effort == pytest.approx(expected, abs=1.2 * FRICTION / GEAR)
            assert [row for m in residuals if any(row := (*m.position, *m.velocity, *m.effort))] == []
        finally:
            chain.end()
            print(chain.logs())
    assert main(["replay", str(run)]) == 0
