"""Parameters of a board: syntax ``NAME=VALUE``, and consistency.

All computations use the raw integers of the firmware, so that a parameter that was read compares equal to one that was
written.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

from servo_msgs_py.catalogue import Catalogue, Value, Variable
from servo_msgs_py.value_text import parse_assignment, parse_element, parse_values

PREFIX: Final = "param."
"""Prefix of the names of all parameters."""

RawParameters = Mapping[str, Sequence[int]]
"""Raw integers, one per element, by name of the variable."""

_ORDERED: Final = (("param.position_min", "param.position_max"),)  # the first must not exceed the second

COMPARED: Final = frozenset(name for pair in _ORDERED for name in pair)
"""Parameters that `contradiction` checks."""


@dataclass(frozen=True)
class Assignment:
    """New value of one parameter or of one element of it."""

    variable: Variable  # the parameter
    element: int | None  # index of the element; None for all
    raw: tuple[int, ...]  # firmware integers, one per assigned element
    text: str  # as entered

    def replaces(self, other: Assignment) -> bool:
        """Whether this assignment overwrites `other` completely."""
        return self.variable.name == other.variable.name and self.element in (None, other.element)


def parameters(catalogue: Catalogue) -> list[Variable]:
    """All parameters of a board, in the order of the table."""
    return [v for v in catalogue.variables.values() if v.name.startswith(PREFIX)]


@cache
def parameter_names() -> frozenset[str]:
    """Names of all parameters of the packaged catalogue."""
    return frozenset(variable.name for variable in parameters(Catalogue.load()))


def find(text: str, catalogue: Catalogue) -> tuple[Variable, int | None]:
    """Parameter and index of the element in ``param.features`` or ``param.features[0]``; index None for all.

    Raises
    ------
    ValueError
        If it does not exist.
    """
    name, element = parse_element(text)
    try:
        variable = catalogue[name]
    except KeyError as error:
        raise ValueError(str(error.args[0])) from None
    if not variable.name.startswith(PREFIX):
        raise ValueError(f"{variable.name} is not a parameter; names of parameters begin with {PREFIX}")
    if element is not None and element >= variable.count:
        raise ValueError(f"{variable.name} has elements 0 .. {variable.count - 1}, not {element}")
    return variable, element


def parse(text: str, catalogue: Catalogue) -> Assignment:
    """Read ``param.features[0]=ANTI_WINDUP+DEAD_TIME`` or ``param.i_q_limit=1.0,1.5``.

    Raises
    ------
    ValueError
        If the parameter does not exist or the value is invalid; the text contains the reason.
    """
    target, value = parse_assignment(text, "NAME=VALUE, for example param.i_q_limit[0]=1.5")
    variable, element = find(target, catalogue)
    try:
        values = parse_values(variable, value, catalogue)
    except ValueError as error:
        raise ValueError(f"{target}: {error}") from None
    expected = variable.count if element is None else 1
    if len(values) != expected:
        hint = "; give all values separated by commas, or the index of one element" if expected > 1 else ""
        raise ValueError(f"{target}: {len(values)} value(s) given, {expected} expected{hint}")
    return Assignment(variable, element, tuple(variable.to_raw(v) for v in values), f"{target}={value}")


def merged(before: Iterable[Assignment], later: Iterable[Assignment]) -> list[Assignment]:
    """Both in order, without assignments that a later one overwrites."""
    result: list[Assignment] = []
    for assignment in (*before, *later):
        result = [kept for kept in result if not assignment.replaces(kept)] + [assignment]
    return result


def applied(assignments: Iterable[Assignment], present: RawParameters) -> dict[str, list[int]]:
    """Result of the assignments; a parameter with an unknown element is omitted."""
    result = {name: list(raw) for name, raw in present.items()}
    for assignment in assignments:
        name = assignment.variable.name
        if assignment.element is None:
            result[name] = list(assignment.raw)
        elif name in result:
            result[name][assignment.element] = assignment.raw[0]
    return result


def contradiction(values: RawParameters, catalogue: Catalogue) -> str:
    """Contradiction in a set of parameters; empty if there is none."""
    for low_name, high_name in _ORDERED:
        low, high = catalogue[low_name], catalogue[high_name]
        for k, (minimum, maximum) in enumerate(zip(values.get(low_name, ()), values.get(high_name, ()), strict=False)):
            if minimum > maximum:
                return (
                    f"{low_name}[{k}] {low.scale(minimum):.6g} {low.unit} exceeds {high_name}[{k}] "
                    f"{high.scale(maximum):.6g} {high.unit}: no motion would be possible"
                )
    return ""


def si(values: RawParameters, catalogue: Catalogue) -> dict[str, Value]:
    """SI values, lists for arrays."""
    result: dict[str, Value] = {}
    for name, raw in values.items():
        numbers = [catalogue[name].scale(number) for number in raw]
        result[name] = numbers[0] if catalogue[name].count == 1 else numbers
    return result
