"""Values of remedies, found by trying: a value is accepted by all checks, and no check needs a second formula.

A check names the entries that can help and their direction (`errors`). `tried` searches for each of them the value
nearest to the present one with which nothing is refused or, if there is none, with which the next refusal is about
another entry. If that refusal contradicts the change, both entries are changed together. `corrected` applies remedies
until nothing is refused.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue

from servo_tuning.braking import brake_constants
from servo_tuning.constants import time_outs
from servo_tuning.errors import EXACT, ConfigError, Problem, Remedy, Table
from servo_tuning.reading import parse
from servo_tuning.tuned import tuned

CORRECTIONS_MAX: Final = 20  # of one table

_STEPS: Final = (0.01, 0.02, 0.04, *(0.08 * k for k in range(1, 30)), *(2.4 + 0.25 * k for k in range(28)))
"""Logarithms of the tried factors, 1 % .. 9000. An accepted range narrower than 8 % (28 % beyond a factor of 11) can be
missed."""
_BISECTIONS: Final = 12
_DIGITS: Final = (3, 4, 6)  # significant digits of a value, the first that is accepted

Check = Callable[[Table], Problem | None]
"""First problem of a table; None: accepted."""
Write = Callable[[Table, str, float], Table]
"""Copy of a table with another value of an entry."""


def refusal_of(table: Table) -> Problem | None:
    """First refusal of a configuration; None: every number of it can be used."""
    try:
        configuration = parse(table, Catalogue.load())
        for axis in configuration.axes:
            tuned(axis, configuration)
        if configuration.board.complete:
            brake_constants(configuration)
        time_outs(configuration.board)
    except ConfigError as error:
        return error.problem
    return None


def value_in(table: Table, entry: str) -> object:
    """Value of an entry, of [defaults] if the axis has none of its own; None if there is none."""
    owner, *path = entry.split(".")
    for source in (owner, "defaults"):
        place: Any = table.get(source)
        for key in path:
            place = place.get(key) if isinstance(place, Mapping) else None
        if place is not None:
            return place
        if owner == "board":
            break
    return None


def with_value(table: Table, entry: str, value: float) -> dict[str, Any]:
    """Copy of a table with another value of an entry."""
    result = copy.deepcopy(dict(table))
    *groups, key = entry.split(".")
    place = result
    for group in groups:
        place = place.setdefault(group, {})
    place[key] = value
    return result


def applied(table: Table, remedy: Remedy, write: Write = with_value) -> Table:
    """Copy of a table with the values of a remedy."""
    assert remedy.value is not None, remedy.entry
    table = write(table, remedy.entry, int(remedy.value) if remedy.whole else remedy.value)
    return table if remedy.also is None else applied(table, remedy.also, write)


def tried(problem: Problem, table: Table, check: Check = refusal_of, write: Write = with_value) -> Problem:
    """Return the problem with the accepted values of its remedies, without those that have none.

    Parameters
    ----------
    problem : Problem
    table : mapping
        Table with this problem.
    check, write : callable, optional
        With which values are tried.
    """
    search = _Search(table, problem.entry, check, write)
    for attempt in (search.alone, search.next, search.together):
        found = [attempt(one) for one in problem.remedies]
        if changes := tuple(one for one in found if one is not None):
            return replace(problem, remedies=changes)
    if not problem.remedies or problem.advice:
        return replace(problem, remedies=())
    names = ", ".join(one.entry for one in problem.remedies)
    return replace(problem, remedies=(), fact=f"{problem.fact}; no other value of {names} alone is accepted")


def explained(error: ConfigError) -> ConfigError:
    """The refusal with the values of its remedies, for a message to the user; the search takes up to a second."""
    return ConfigError(tried(error.problem, error.table)) if error.table else error


@dataclass(frozen=True)
class Correction:
    """Table with the remedies of its problems."""

    table: Table
    corrected: tuple[Problem, ...]  # in the order of their correction
    problem: Problem | None  # the first without a permitted remedy; None: accepted


def corrected(
    table: Table, permitted: Callable[[Remedy], bool], check: Check = refusal_of, write: Write = with_value
) -> Correction:
    """Apply the first permitted remedy of each problem until the table is accepted.

    Parameters
    ----------
    table : mapping
    permitted : callable
        Whether the entry of a remedy may be changed; only such are tried.
    check, write : callable, optional
        With which values are tried.
    """
    done: list[Problem] = []
    while (problem := check(table)) is not None and len(done) < CORRECTIONS_MAX:
        search = _Search(table, problem.entry, check, write)
        wanted = list(filter(permitted, problem.remedies))
        found = (attempt(one) for attempt in (search.next, search.together) for one in wanted)
        remedy = next((one for one in found if one and (one.also is None or permitted(one.also))), None)
        if remedy is None:
            break
        done.append(problem)
        table = applied(table, remedy, write)
    return Correction(table, tuple(done), problem)


@dataclass(frozen=True)
class _Search:
    """Search of values by trying."""

    table: Table  # with the problem
    entry: str  # that the problem is about
    check: Check
    write: Write

    def alone(self, remedy: Remedy) -> Remedy | None:
        """The remedy with a value that is accepted."""
        return self._nearest(remedy, lambda problem, _: problem is None)

    def next(self, remedy: Remedy) -> Remedy | None:
        """The remedy with a value with which another entry has a problem, not because of this change."""

        def good(problem: Problem | None, direction: int) -> bool:
            if problem is None:
                return True
            reverse = any(one.entry == remedy.entry and -direction in one.directions for one in problem.remedies)
            return problem.entry != self.entry and not reverse

        return self._nearest(remedy, good)

    def together(self, remedy: Remedy) -> Remedy | None:
        """The remedy with a change of another entry, which has a problem because of this one."""
        first = self._nearest(remedy, lambda problem, _: problem is None or problem.entry != self.entry)
        if first is None:
            return None
        table = applied(self.table, first, self.write)
        problem = self.check(table)
        assert problem is not None, "a value that is accepted alone has been tried before"
        search = replace(self, table=table, entry=problem.entry)
        others = (search.alone(one) for one in problem.remedies if one.entry != remedy.entry)
        also = next((one for one in others if one is not None), None)
        exact = (EXACT,)  # each bound depends on the other value
        return None if also is None else replace(first, directions=exact, also=replace(also, directions=exact))

    def _nearest(self, remedy: Remedy, good: Callable[[Problem | None, int], bool]) -> Remedy | None:
        """The remedy with the good value that is nearest to the present one; None if there is none."""
        if remedy.value is not None:
            return remedy
        present = value_in(self.table, remedy.entry)
        if isinstance(present, bool) or not isinstance(present, (int, float)) or not present:
            return None
        found = []
        for direction in remedy.directions:
            value = self._value(remedy, direction, float(present), good)
            if value is not None:
                distance = abs(math.log(value / present)) if value / present > 0.0 else math.inf
                found.append((distance, replace(remedy, directions=(direction,), value=value)))
        return min(found, key=lambda pair: pair[0])[1] if found else None

    def _value(
        self, remedy: Remedy, direction: int, present: float, good: Callable[[Problem | None, int], bool]
    ) -> float | None:
        problems: dict[float, Problem | None] = {}

        def accepted(value: float) -> bool:
            if value not in problems:
                problems[value] = self.check(applied(self.table, replace(remedy, value=value), self.write))
            return good(problems[value], direction)

        def at(log: float) -> float:
            value = present * math.exp(direction * log)
            return float((math.ceil if direction > 0 else math.floor)(value)) if remedy.whole else value

        low = 0.0
        for high in _STEPS:
            if accepted(at(high)):
                break
            low = high
        else:
            return None
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if accepted(at(middle)) else (middle, high)
        return next(filter(accepted, _short(at(high), direction)), at(high))


def _short(value: float, direction: int) -> Iterator[float]:
    """Values with few digits next to a value, the second of each pair beyond it."""
    for digits in _DIGITS:
        nearest = float(f"{value:.{digits}g}")
        step = 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)
        yield from (nearest, float(f"{nearest + direction * math.copysign(step, value):.{digits}g}"))
