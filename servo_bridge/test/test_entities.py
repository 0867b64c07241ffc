"""Destruction of the entities of a node."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from servo_bridge.entities import Entities
from std_msgs.msg import String

MESSAGE = 30_000_000
"""Size of a message that the transport cannot hold [bytes]."""

READER = f"""
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

rclpy.init()
node, sizes = rclpy.create_node("reader"), []
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(String, "last", lambda message: sizes.append(len(message.data)), qos)
while {MESSAGE} not in sizes:
    rclpy.spin_once(node, timeout_sec=0.1)
print("arrived")
"""


@pytest.mark.realtime
def test_last_message_arrives_before_its_publisher_is_destroyed() -> None:
    context = Context()
    rclpy.init(context=context)
    node = Node("writer", context=context)
    entities = Entities(node)
    publisher = node.create_publisher(String, "last", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    with subprocess.Popen([sys.executable, "-c", READER], stdout=subprocess.PIPE, text=True) as reader:
        try:
            while publisher.get_subscription_count() == 0:
                time.sleep(0.01)
            publisher.publish(String(data="x" * MESSAGE))
            entities.destroy()
            assert reader.communicate(timeout=20.0)[0] == "arrived\n"
        finally:
            reader.kill()
            node.destroy_node()
            rclpy.shutdown(context=context)
