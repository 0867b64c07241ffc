"""Entities that a node creates after a moment, to be destroyed together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rclpy.node import Node


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
        """Destroy the entities; in the thread of the executor, also from a callback."""
        node = self._node
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
