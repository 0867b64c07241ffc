"""Entry points of the programs that need ROS; this module does not import rclpy."""

from __future__ import annotations

from servo_msgs_py.runtime.ros_program import run_with_ros


def bridge() -> int:
    """``servo_bridge``."""
    return run_with_ros("servo_bridge", "servo_bridge.node")


def command() -> int:
    """``servo-command``."""
    return run_with_ros("servo-command", "servo_bridge.command")


def demo() -> int:
    """``servo-demo``."""
    return run_with_ros("servo-demo", "servo_bridge.demo")
