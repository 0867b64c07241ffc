"""Nodes that refuse their parameters leave nothing of themselves in the process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from servo_bridge.node import ServoBridge
from servo_msgs_py.node_shell import ParameterError
from servo_twin.node import ServoTwin
from servo_twin.viewer_node import ServoViewer


def bridge(**node_arguments: Any) -> Node:
    return ServoBridge(lambda work: work(), **node_arguments)


@pytest.mark.parametrize(
    ("node", "parameter", "value", "name"),
    [
        (bridge, "joints", ["one"], "servo_bridge"),
        (ServoTwin, "seed", -1, "servo_twin"),
        (ServoViewer, "web", False, "servo_viewer"),
    ],
)
def test_refused_node_is_gone(node: Callable[..., Node], parameter: str, value: Any, name: str) -> None:
    """At once: the exception, which somebody may keep, holds all that is left of it."""
    context = rclpy.Context()
    rclpy.init(context=context)
    try:
        observer = Node("observer", context=context)
        with pytest.raises(ParameterError) as refused:
            node(context=context, parameter_overrides=[Parameter(parameter, value=value)])
        names = observer.get_node_names()
        assert "observer" in names
        assert name not in names, refused
    finally:
        rclpy.shutdown(context=context)
