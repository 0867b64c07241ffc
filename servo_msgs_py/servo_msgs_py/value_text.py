"""Text format of variables and their values: elements, assignments, numbers, names of values, flags joined by ``+``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

from servo_msgs_py.catalogue import Catalogue, Value, Variable

NO_FLAG: Final = "none"
"""Text of a flag word without a set flag."""


_ELEMENT: Final = re.compile(r"(?P<name>.+)\[(?P<index>\d+)\]")


def parse_element(text: str) -> tuple[str, int | None]:
    """Name and index in ``cmd.position[1]``; the whole text and None without an index."""
    match = _ELEMENT.fullmatch(text)
    return (text, None) if match is None else (match["name"], int(match["index"]))


def parse_assignment(text: str, form: str) -> tuple[str, str]:
    """Name and value in ``NAME=VALUE``, without blanks around them.

    Raises
    ------
    ValueError
        If a part is missing; the text asks for `form`.
    """
    name, sign, value = (part.strip() for part in text.partition("="))
    if not (name and sign and value):
        raise ValueError(f"{text!r}: write {form}")
    return name, value


def labels_of(variable: Variable, catalogue: Catalogue) -> Mapping[str, int]:
    """Names of enumeration values or flags of a variable with their numbers; empty for numeric variables."""
    if variable.enum is not None:
        return catalogue.enums[variable.enum]
    if variable.flags is not None:
        return {NO_FLAG: 0} | {flag.name: flag.mask for flag in catalogue.flags[variable.flags]}
    return {}


def parse_number(word: str, labels: Mapping[str, int], *, joined: bool = False) -> int | float:
    """Read a number or its name, in upper or lower case.

    Parameters
    ----------
    word : str
        Text of the number or name.
    labels : mapping
        Names and their numbers.
    joined : bool
        Whether names are flags, which may be joined by ``+``.

    Raises
    ------
    ValueError
        If it is neither; the text contains the invalid part and the valid names.
    """
    for convert in (lambda w: int(w, 0), float):
        try:
            result: int | float = convert(word)
        except ValueError:
            continue
        return result
    named = {name.upper(): value for name, value in labels.items()}
    parts = [part.strip() for part in (word.split("+") if joined else [word])]
    unknown = [part for part in parts if part.upper() not in named]
    if unknown:
        known = f" or one of the names {', '.join(labels)}" if labels else ""
        raise ValueError(f"{unknown[0]!r} is not a number{known}")
    number = 0
    for part in parts:
        number |= named[part.upper()]
    return number


def parse_values(variable: Variable, text: str, catalogue: Catalogue) -> list[int | float]:
    """Read comma-separated numbers or names; see `parse_number`."""
    labels, joined = labels_of(variable, catalogue), variable.flags is not None
    return [parse_number(word.strip(), labels, joined=joined) for word in text.split(",")]


def name_text(variable: Variable, number: float, catalogue: Catalogue) -> str:
    """Name of a number in the syntax of `parse_number`; empty for numeric variables and numbers without a name."""
    if variable.flags is not None:
        known = [flag.name for flag in catalogue.active(variable.flags, int(number))]
        return "+".join(known) or (NO_FLAG if not number else "")
    if variable.enum is not None:
        return catalogue.label(variable.enum, int(number))
    return ""


def number_text(number: float) -> str:
    """Shortest text with nine significant digits, sufficient to distinguish raw numbers of 24 bits or more."""
    return str(number) if isinstance(number, int) else f"{number:.9g}"


def value_text(variable: Variable, value: Value, catalogue: Catalogue) -> str:
    """Value with unit and, for enumerations and flags, with names."""
    if isinstance(value, bytes):
        return value.hex(" ")
    numbers: Sequence[float] = value if isinstance(value, list) else [value]
    names = [name_text(variable, number, catalogue) for number in numbers]
    unit = f" {variable.unit}" if variable.unit else ""
    return ", ".join(map(number_text, numbers)) + unit + (f" ({', '.join(names)})" if any(names) else "")
