"""Entities that a node creates after a moment, to be destroyed together."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, Final

from rclpy.duration import Duration
from rclpy.node import Node

_ACKNOWLEDGED: Final = 1.0
"""Longest wait for the readers of the last messages [s]; a hung reader acknowledges nothing."""


class Entities:
    """Publishers, subscriptions, services, clients, timers and waitables that a node creates after this object.

    Parameters
    ----------
    node : Node
        Owner of the entities.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._before = frozenset(_all(node))

    def destroy(self) -> None:
        """Destroy the entities after their last messages have arrived; in the executor's thread, also in a callback.

        A publisher that is destroyed does not repeat what the transport lost: its last state would be missing.
        """
        node = self._node
        deadline = time.monotonic() + _ACKNOWLEDGED
        for publisher in self._new(node.publishers):
            publisher.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))
        for entities, destroy in (
            (node.publishers, node.destroy_publisher),
            (node.subscriptions, node.destroy_subscription),
            (node.services, node.destroy_service),
            (node.clients, node.destroy_client),
            (node.timers, node.destroy_timer),
            (
                node.waitables,
                lambda waitable: waitable.destroy(),
            ),  # such as actions, which remove themselves from the node
        ):
            for entity in self._new(entities):
                destroy(entity)

    def _new(self, entities: Iterable[Any]) -> list[Any]:
        return [entity for entity in entities if entity not in self._before]


def _all(node: Node) -> list[Any]:
    return [*node.publishers, *node.subscriptions, *node.services, *node.clients, *node.timers, *node.waitables]
