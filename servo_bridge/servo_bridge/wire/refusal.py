"""Text of a write that the board refuses because of its value."""

from __future__ import annotations

from servo_msgs_py.catalogue import Catalogue, Variable


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
    low, high = variable.raw_range
    for element, number in enumerate(raw, first):
        if not low <= number <= high:
            return variable.outside_text(variable.scale(number), element)
    values = ", ".join(f"{variable.scale(number):g}" for number in raw)
    name = f"{variable.name}[{first}]" if len(raw) < variable.count else variable.name
    if variable.name == "cmd.position":
        reach = variable.scale(catalogue.bits["position"]["REACH"])
        return (
            f"{name}: {values} {variable.unit} is more than {reach:g} {variable.unit} away from the shaft; "
            "move in steps"
        )
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
    return f"{name}: the board refuses {values} {variable.unit}".rstrip()
