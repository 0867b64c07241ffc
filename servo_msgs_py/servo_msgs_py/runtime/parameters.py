"""Parameters of a node: descriptions, declaration, the text of ``--help`` and the parameter file with the defaults."""

from __future__ import annotations

import difflib
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node

from servo_msgs_py.quantity import FINITE, Quantity

_HELP_WIDTH: Final = 79
_FILE_WIDTH: Final = 120
_INDENT: Final = "    "
_NO_BREAK: Final = "\N{NO-BREAK SPACE}"


def _decimal(value: float) -> str:
    """A number without an exponent, which YAML would need in a form of its own."""
    return f"{value:.15f}".rstrip("0").rstrip(".")


class ParameterError(ValueError):
    """A parameter is invalid; the text contains its name and its valid values."""


@dataclass(frozen=True, kw_only=True)
class Spec(Quantity):
    """One parameter: a quantity, a list of them or a text, with a default.

    In a managed node, a `read_only` parameter can change only while the node is unconfigured.
    """

    default: Any
    read_only: bool = True  # cannot change at run time

    @property
    def limits(self) -> str:
        """Range such as ``0 .. 1``; empty: no limit."""
        return "" if self.maximum == FINITE else f"{_decimal(self.minimum)} .. {_decimal(self.maximum)}"

    def descriptor(self, *, managed: bool = False) -> ParameterDescriptor:
        """ROS descriptor; a managed node has no read-only parameters in ROS, so the node has to reject changes."""
        result = ParameterDescriptor(description=self.text, read_only=self.read_only and not managed)
        if self.read_only and managed:
            result.additional_constraints = "can be changed only while the node is unconfigured"
        if self.limits:
            kind, number = (IntegerRange, int) if isinstance(self.default, int) else (FloatingPointRange, float)
            limits = kind(from_value=number(self.minimum), to_value=number(self.maximum), step=number(0))
            setattr(result, "integer_range" if kind is IntegerRange else "floating_point_range", [limits])
        return result


def spec(
    default: object, text: str, minimum: float = -FINITE, maximum: float = FINITE, *, read_only: bool = True
) -> Spec:
    """Return a parameter; see `Spec`."""
    return Spec(default=default, text=text, minimum=minimum, maximum=maximum, read_only=read_only)


def declare(node: Node, parameters: Mapping[str, Spec], *, managed: bool = False) -> dict[str, Any]:
    """Declare parameters and return their values.

    Parameters
    ----------
    node : Node
        Owner.
    parameters : mapping of str to Spec
        What to declare.
    managed : bool
        Whether the node has a lifecycle.

    Raises
    ------
    ParameterError
        If a given value has the wrong type or is out of range.
    """
    values: dict[str, Any] = {}
    for name, spec in parameters.items():
        try:
            values[name] = node.declare_parameter(name, spec.default, spec.descriptor(managed=managed)).value
        except ParameterException as error:
            raise ParameterError(f"parameter {name}: {error}; description: {spec.text}") from None
    return values


def warn_of_unknown(node: Node) -> None:
    """Log a warning for each given value of a parameter that the node has not declared; rclpy ignores it silently.

    This is no error: a parameter file for ``/**`` may have parameters of several nodes.
    """
    known = node.get_parameters_by_prefix("")
    for name in sorted(node._parameter_overrides.keys() - known.keys()):  # rclpy has no public access
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}?" if near else "none has a similar name"
        node.get_logger().warning(f"parameter {name} does not exist and is ignored; {hint}")


def help_text(name: str, purpose: str, parameters: Mapping[str, Spec]) -> str:
    """Text of ``--help`` of a node."""
    lines = [
        f"usage: {name} [-h | --parameter-file]",
        "       [--ros-args -p NAME:=VALUE ... -r FROM:=TO ... --params-file FILE]",
        "",
        *textwrap.wrap(purpose, _HELP_WIDTH),
        "",
        "--parameter-file prints a parameter file with the defaults",
        "",
        "parameters:",
    ]
    for key, spec in parameters.items():
        limits = f", {spec.limits}" if spec.limits else ""
        text = f"{spec.text} (default: {spec.default!r}{limits})"
        indent = 6 * " "
        lines += [f"  {key}"]
        lines += textwrap.wrap(
            text, _HELP_WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False
        )
    return "\n".join(lines)


def ros_parameter_file(name: str, parameters: Mapping[str, Spec]) -> str:
    """Parameter file for ``--params-file``: every parameter of a node with its description and default."""
    at_start = all(spec.read_only for spec in parameters.values())
    access = (
        "All are read at the start only."
        if at_start
        else '"Read-only": can be changed only while the node is unconfigured (doc/lifecycle.md).'
    )
    lines = [
        f"# Every parameter of {name} with its default, as `{name} --parameter-file` prints it. Change what you need",
        "# in a copy of this file, and start with",
        "#",
        f"#   {name} --ros-args --params-file my.yaml",
        "#",
        f"# {access}",
        "# Write 1.5e+6, not 1.5e6, which `ros2 param load` reads as a text.",
        "/**:",
        "  ros__parameters:",
    ]
    for key, spec in parameters.items():
        sentences = [f"{spec.text[0].upper()}{spec.text[1:]}."]
        if spec.limits:
            sentences.append(f"Range: {spec.limits}.".replace(" ", _NO_BREAK))
        if spec.read_only and not at_start:
            sentences.append("Read-only.")
        comment = f"{_INDENT}# "
        wrapped = textwrap.wrap(
            " ".join(sentences), _FILE_WIDTH, initial_indent=comment, subsequent_indent=comment, break_on_hyphens=False
        )
        lines += [line.replace(_NO_BREAK, " ") for line in wrapped]
        one_line = None if isinstance(spec.default, list) else False  # of PyYAML: lists as [a, b], but no {name: value}
        entry = yaml.safe_dump({key: spec.default}, default_flow_style=one_line, width=_FILE_WIDTH - 4 * len(_INDENT))
        lines += textwrap.indent(entry, _INDENT).splitlines()
    return "\n".join(lines) + "\n"
