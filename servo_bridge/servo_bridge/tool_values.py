"""Numbers and names for people: what `servo-tool` prints and understands. Pure."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence

from servo_msgs_py.catalogue import Catalogue, Value, Variable

from servo_bridge.freemaster.tsa import Number
from servo_bridge.wire.session import BoardVariable

__all__ = ["UnknownVariableError", "UsageError", "limits_text", "lookup", "number_text", "parse_values", "value_text"]

_INDEXED = re.compile(r"(?P<name>.+)\[(?P<index>\d+)\]\Z")


class UsageError(ValueError):
    """The command line does not make sense."""


class UnknownVariableError(LookupError):
    """The board has no such variable."""


def lookup(variables: Mapping[str, BoardVariable], text: str) -> tuple[BoardVariable, int | None]:
    """Find a variable, or an element of one as in ``cmd.position[1]``.

    Returns
    -------
    variable, element : BoardVariable, int or None
        Element is None for the whole variable.

    Raises
    ------
    UnknownVariableError
        With the closest names.
    """
    if text in variables:
        return variables[text], None
    match = _INDEXED.match(text)
    if match is not None and match["name"] in variables:
        variable = variables[match["name"]]
        if int(match["index"]) >= variable.count:
            raise UnknownVariableError(f"{variable.name} has elements 0 .. {variable.count - 1}")
        return variable, int(match["index"])
    near = difflib.get_close_matches(text, variables, n=3)
    hint = f"; did you mean {', '.join(near)}?" if near else "; `servo-tool vars` lists all"
    raise UnknownVariableError(f"the board has no variable {text!r}{hint}")


def parse_values(variable: BoardVariable, text: str, catalogue: Catalogue) -> list[Number]:
    """Read comma-separated numbers; names of enumeration values are understood, and flags joined by ``+``.

    Raises
    ------
    UsageError
        If one is no number.
    """
    return [_parse_number(variable, word.strip(), catalogue) for word in text.split(",")]


def _parse_number(variable: BoardVariable, word: str, catalogue: Catalogue) -> Number:
    labels = _labels(variable, catalogue)
    named = {name.upper(): value for name, value in labels}
    parts = [part.strip().upper() for part in (word.split("+") if _is_flags(variable) else [word])]
    if all(part in named for part in parts):
        number = 0
        for part in parts:
            number |= named[part]
        return number
    for convert in (lambda w: int(w, 0), float):
        try:
            result: Number = convert(word)
        except ValueError:
            continue
        return result
    known = f"; it may also be {', '.join(name for name, _ in labels)}" if labels else ""
    raise UsageError(f"{word!r} is not a number{known}")


def _is_flags(variable: BoardVariable) -> bool:
    return variable.contract is not None and variable.contract.flags is not None


def _labels(variable: BoardVariable, catalogue: Catalogue) -> Sequence[tuple[str, int]]:
    contract = variable.contract
    if contract is not None and contract.enum is not None:
        return list(catalogue.enums[contract.enum].items())
    if contract is not None and contract.flags is not None:
        return [("none", 0), *((flag.name, flag.mask) for flag in catalogue.flags[contract.flags])]
    return variable.target.type.labels


def value_text(variable: BoardVariable, value: Value, catalogue: Catalogue) -> str:
    """Value with unit, and in words where the number stands for something."""
    if isinstance(value, bytes):
        return value.hex(" ")
    numbers = value if isinstance(value, list) else [value]
    text = ", ".join(number_text(number) for number in numbers)
    unit = f" {variable.unit}" if variable.unit else ""
    words = [_words(variable, number, catalogue) for number in numbers]
    return f"{text}{unit}" + (f" ({', '.join(words)})" if any(words) else "")


def number_text(number: Number) -> str:
    """Shortest text of nine significant digits; every raw number of 24 bits and more stays distinguishable."""
    return str(number) if isinstance(number, int) else f"{number:.9g}"


def _words(variable: BoardVariable, number: Number, catalogue: Catalogue) -> str:
    contract = variable.contract
    if contract is not None and contract.flags is not None:
        return " ".join(flag.name for flag in catalogue.active(contract.flags, int(number)))
    if contract is not None and contract.enum is not None:
        return catalogue.label(contract.enum, int(number))
    return variable.target.type.label(number) or ""


def limits_text(contract: Variable | None) -> str:
    """Limits of what may be written, empty when it may not be."""
    if contract is None or not contract.writable:
        return ""
    return f"{number_text(contract.minimum)} .. {number_text(contract.maximum)}"


def describe(variables: Iterable[BoardVariable]) -> list[tuple[str, str, str, str, str, str]]:
    """Rows of a table of variables: name, type, access, unit, limits, description."""
    rows = []
    for variable in variables:
        contract = variable.contract
        count = f"[{variable.count}]" if variable.count > 1 else ""
        type_ = variable.target.type.name if contract is None else contract.type
        if variable.is_block:
            count = f"[{variable.size}]"
        access = "rw" if variable.target.writable else "ro"
        text = "" if contract is None else contract.description
        rows.append((variable.name, type_ + count, access, variable.unit, limits_text(contract), text))
    return rows
