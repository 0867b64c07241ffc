"""All messages that the node of the bridge publishes and receives, and the calls of its services, for recordings.

They are taken where they are serialised and before they are deserialised: nothing is lost on the way through the
middleware, and nothing is converted twice.
"""

from __future__ import annotations

import json
import time
from array import array
from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy
from rclpy.serialization import serialize_message
from servo_msgs_py.run_file.topic import Topic, type_of
from std_msgs.msg import String

from servo_msgs_py import topics

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

    def of_service(self, name: str, namespace: str) -> Callable[[Any, str], None]:
        """Function to be called with every request and response of a service or action, and which of both it is.

        Parameters
        ----------
        name : str
            Of the service, absolute.
        namespace : str
            Of the topic `topics.CALLS`.
        """
        topic = Topic(f"{namespace.rstrip('/')}/{topics.CALLS}", type_of(String))

        def seen(message: Any, kind: str) -> None:
            if self.receiver is not None:
                text = json.dumps({"service": name, kind: _plain(message)})
                self.receiver(topic, serialize_message(String(data=text)), time.time_ns())

        return seen

    def add(self, topic: Topic, serialised: Callable[[], bytes]) -> None:
        """Pass a message that is on no topic of the node."""
        if self.receiver is not None:
            self.receiver(topic, serialised(), time.time_ns())


def _plain(value: Any) -> Any:
    """A message, or a value in one, as JSON has it."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, (list, array)):
        return [_plain(each) for each in value]
    return value if isinstance(value, (str, int, float)) else str(value)
