"""Text of numbers and names in `servo-tool`: output and parsing."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

from servo_msgs_py.catalogue import Catalogue, Value, Variable
from servo_msgs_py.value_text import number_text

from servo_bridge.freemaster.tsa import Number
from servo_bridge.wire.session import BoardVariable
from servo_msgs_py import value_text as value_text_of

__all__ = [
    "UnknownVariableError",
    "UsageError",
    "limits_text",
    "lookup",
    "number_text",
    "opened",
    "parse_values",
    "value_text",
]


class UsageError(ValueError):
    """Wrong arguments of the command line."""


class UnknownVariableError(LookupError):
    """Unknown variable."""


def lookup(variables: Mapping[str, BoardVariable], text: str) -> tuple[BoardVariable, int | None]:
    """Find a variable or an element, such as ``cmd.position[1]``.

    Returns
    -------
    variable, element : BoardVariable, int or None
        Element is None for the whole variable.

    Raises
    ------
    UnknownVariableError
        If it is unknown, with the closest names.
    """
    if text in variables:
        return variables[text], None
    name, index = value_text_of.parse_element(text)
    if index is not None and name in variables:
        variable = variables[name]
        if index >= variable.count:
            raise UnknownVariableError(f"{variable.name} has elements 0 .. {variable.count - 1}")
        return variable, index
    near = difflib.get_close_matches(text, variables, n=3)
    hint = f"; did you mean {', '.join(near)}?" if near else "; `servo-tool vars` lists all"
    raise UnknownVariableError(f"the board has no variable {text!r}{hint}")


def opened(variables: Mapping[str, BoardVariable], names: Iterable[str]) -> list[str]:
    """Replace structures by their members, without duplicates.

    Parameters
    ----------
    variables : mapping
        Variables of the board.
    names : iterable of str
        Given names; names of other variables are kept.
    """
    result: dict[str, None] = {}
    for name in names:
        variable = variables.get(name)
        if variable is not None and variable.is_block and variable.target.members:
            inside = [member for member in variable.target.members if member in variables]
            result.update(dict.fromkeys(opened(variables, inside)))
        else:
            result[name] = None
    return list(result)


def parse_values(variable: BoardVariable, text: str, catalogue: Catalogue) -> list[Number]:
    """Parse comma-separated numbers, names of enumeration values, and flags joined by ``+``.

    Raises
    ------
    UsageError
        If a value is not a number or a known name.
    """
    try:
        if variable.contract is not None:
            return list(value_text_of.parse_values(variable.contract, text, catalogue))
        labels = dict(variable.target.type.labels)
        return [value_text_of.parse_number(word.strip(), labels) for word in text.split(",")]
    except ValueError as error:
        raise UsageError(f"{variable.name}: {error}") from None


def value_text(variable: BoardVariable, value: Value, catalogue: Catalogue) -> str:
    """Text of a value with unit, and with names where numbers have one."""
    if variable.contract is not None:
        return value_text_of.value_text(variable.contract, value, catalogue)
    if isinstance(value, bytes):
        return value.hex(" ")
    numbers = value if isinstance(value, list) else [value]
    words = [variable.target.type.label(number) or "" for number in numbers]
    return ", ".join(map(number_text, numbers)) + (f" ({', '.join(words)})" if any(words) else "")


def limits_text(contract: Variable | None) -> str:
    """Text of the limits of writes; empty if read-only."""
    if contract is None or not contract.writable:
        return ""
    return f"{number_text(contract.minimum)} .. {number_text(contract.maximum)}"


def describe(variables: Iterable[BoardVariable], catalogue: Catalogue) -> list[tuple[str, str, str, str, str, str]]:
    """Rows of a table of variables: name, type, access, unit, limits, description."""
    rows = []
    for variable in variables:
        contract = variable.contract
        count = f"[{variable.count}]" if variable.count > 1 else ""
        type_ = variable.target.type.name if contract is None else contract.type
        if variable.is_block:
            count = f"[{variable.size}]"
        access = "rw" if variable.target.writable else "ro"
        text = "" if contract is None else contract.text
        if contract is not None and (labels := value_text_of.labels_of(contract, catalogue)):
            text += f": {', '.join(labels)}"
        rows.append((variable.name, type_ + count, access, variable.unit, limits_text(contract), text))
    return rows
