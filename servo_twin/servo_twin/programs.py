"""Entry points of the programs that need ROS; this module does not import rclpy."""

from __future__ import annotations

import sys

from servo_msgs_py.runtime.ros_program import run_with_ros


def twin() -> int:
    """``servo_twin``, and ``servo_twin calibrate``."""
    if sys.argv[1:2] == ["calibrate"]:
        del sys.argv[1]
        return run_with_ros("servo_twin calibrate", "servo_twin.calibrate_node")
    return run_with_ros("servo_twin", "servo_twin.node")


def viewer() -> int:
    """``servo_viewer``."""
    return run_with_ros("servo_viewer", "servo_twin.viewer_node")
