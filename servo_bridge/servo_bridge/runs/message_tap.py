"""All messages that the node of the bridge publishes and receives, for a recording of the run.

They are taken where they are serialised and before they are deserialised: nothing is lost on the way through the
middleware, and nothing is converted twice.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy
from servo_msgs_py.run_file.topic import Topic, type_of

Receiver = Callable[[Topic, bytes, int], None]
"""Receives topic, serialised message and time since the epoch [ns]."""


class MessageTap:
    """Passes every message to a receiver, if there is one; in the thread of the executor."""

    def __init__(self) -> None:
        self.receiver: Receiver | None = None
        self.latched: dict[Topic, bytes] = {}
        """Last message of every latched topic."""

    def of(self, entity: Any, kind: type) -> Callable[[bytes], None]:
        """Function to be called with every serialised message of a publisher or subscription.

        Parameters
        ----------
        entity : Publisher or Subscription
            Of rclpy.
        kind : type
            Class of its messages.
        """
        qos = entity.qos_profile
        latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        topic = Topic(entity.topic_name, type_of(kind), qos.depth, latched)

        def seen(data: bytes) -> None:
            if topic.latched:
                self.latched[topic] = data
            if self.receiver is not None:
                self.receiver(topic, data, time.time_ns())

        return seen
