"""Declared parameters of the nodes of this package: typed defaults, descriptions, ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node

__all__ = ["Described", "ParameterError", "declare"]


class ParameterError(ValueError):
    """A parameter does not make sense; the text names it and says what does."""


@dataclass(frozen=True)
class Described:
    """Default and description of a parameter, and the range of a number. All are read at the start only."""

    default: Any
    description: str
    low: float | None = None
    high: float | None = None

    def descriptor(self) -> ParameterDescriptor:
        """ROS descriptor."""
        result = ParameterDescriptor(description=self.description, read_only=True)
        if self.low is not None and self.high is not None:
            if isinstance(self.default, int):
                result.integer_range = [IntegerRange(from_value=int(self.low), to_value=int(self.high), step=0)]
            else:
                result.floating_point_range = [FloatingPointRange(from_value=self.low, to_value=self.high, step=0.0)]
        return result


def declare(node: Node, parameters: Mapping[str, Described]) -> dict[str, Any]:
    """Declare parameters and return their values.

    Raises
    ------
    ParameterError
        If a given value has the wrong type or is out of range.
    """
    values: dict[str, Any] = {}
    for name, parameter in parameters.items():
        try:
            values[name] = node.declare_parameter(name, parameter.default, parameter.descriptor()).value
        except ParameterException as error:
            raise ParameterError(f"parameter {name}: {error}; it is meant as: {parameter.description}") from None
    return values
