"""Text of a write that the board refuses because of its value."""

from __future__ import annotations

from servo_msgs_py.catalogue import Catalogue, Variable, axis_name
from servo_msgs_py.timed_points import decode_points
from servo_msgs_py.units import PERIOD
from servo_msgs_py.value_text import value_text


def refusal_text(catalogue: Catalogue, variable: Variable, data: bytes, offset: int) -> str:
    """Text with variable, value and permitted range.

    Parameters
    ----------
    catalogue : Catalogue
        Of the board.
    variable : Variable
        The written variable.
    data : bytes
        Written elements.
    offset : int
        Position of the first one after the address of the variable [bytes].
    """
    raw, first = variable.elements(data), offset // variable.element_size
    if variable.name == "cmd.points":
        points = decode_points(catalogue, raw)
        ends = [f"{p.position:g} rad of {axis_name(p.axis)} at {p.tick * PERIOD:g} s" for p in (points[0], points[-1])]
        return f"cmd.points: the board refuses {len(points)} timed points, from {ends[0]} to {ends[1]} of its time"
    if variable.name == "config.window":
        return f"{variable.name}: the board refuses {len(raw)} words of a configuration; send it again"
    low, high = variable.raw_range
    for element, number in enumerate(raw, first):
        if not low <= number <= high:
            return variable.outside_text(variable.scale(number), element)
    values = value_text(variable, [variable.scale(number) for number in raw], catalogue)
    name = f"{variable.name}[{first}]" if len(raw) < variable.count else variable.name
    if variable.name == "cmd.position":
        reach = variable.scale(catalogue.bits["position"]["REACH"])
        return f"{name}: {values} is more than {reach:g} {variable.unit} away from the shaft; move in steps"
    if variable.name in ("param.features", "param.feedback"):
        return (
            f"{name}: the configuration in the board has no values for it, because they were not possible or not "
            "accurate; correct the entry in the warning of `servo-tool tune` and send the configuration again"
        )
    if variable.name == "cmd.enable":
        return (
            f"{name}: the board still has the configuration of a measurement, and restores its own when the shaft is "
            "at rest; bring it to rest and try again"
        )
    return f"{name}: the board refuses {values}; {variable.text}"
