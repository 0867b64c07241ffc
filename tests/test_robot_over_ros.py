"""The arm of MuJoCo, moved over ROS by the bridge: its board is at a pseudo-terminal like any other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from chain import FAST_BAUD, Chain, ros_user
from std_msgs.msg import Float64

pytest.importorskip("mujoco", reason="there is no MuJoCo 4 for Python 3.10")

pytestmark = pytest.mark.realtime

GRAVITY = 9.81 * (0.6 * 0.15 + 0.3 * (0.3 + 0.125))
"""Torque at the shoulder of the horizontal arm, elbow straight [N m]."""
FRICTION = 0.05
"""Of the joint [N m]."""
GEAR = 100.0


def test_arm_is_moved_over_ros(tmp_path: Path) -> None:
    """The effort on `joint_states` is the weight of the arm; the twin, without it, sees that torque as its residual."""
    chain = Chain(tmp_path, FAST_BAUD, level="ideal")
    with ros_user() as user:
        try:
            chain.board(options=["--robot", "arm"])
            chain.bridge()
            chain.twin()
            user.until(user.connected, what="the bridge is not connected")
            user.enable_axes()
            user.position[0].publish(Float64(data=0.25 * np.pi * GEAR))
            user.until(lambda: abs(user.position_of(0) - 0.25 * np.pi * GEAR) < 0.01, what="the arm does not arrive")
            user.wait_board_time(0.3)
            user.until(lambda: user.messages["/twin/residual"], what="the twin has no residual")
            states, residuals = (user.messages[name][-50:] for name in ("/servo/joint_states", "/twin/residual"))
            expected = GRAVITY * np.sin(0.25 * np.pi) / GEAR
            effort = np.mean([message.effort[0] for message in states])
            assert effort == pytest.approx(expected, abs=1.2 * FRICTION / GEAR)
            assert np.mean([message.effort[0] for message in residuals]) > 0.5 * effort
        finally:
            chain.end()
            print(chain.logs())
