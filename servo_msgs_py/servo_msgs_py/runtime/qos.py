"""Quality of service of the topics in `servo_msgs_py.topics`."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


def telemetry_qos(depth: int = 50) -> QoSProfile:
    """Reliable; depth 50, as with depth 10 a Python subscriber loses 5 % of a 500 Hz stream."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def command_qos() -> QoSProfile:
    """Reliable; depth 10."""
    return telemetry_qos(depth=10)


def latched_qos() -> QoSProfile:
    """Transient local, depth 1: a new subscriber receives the last message."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def answers_qos() -> QoSProfile:
    """Transient local, depth 20: a client that is discovered late receives the answers to its commands."""
    return QoSProfile(depth=20, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
