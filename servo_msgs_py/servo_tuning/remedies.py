"""Values of remedies, found by trying: a value is accepted by all checks, and no check needs a second formula.

A check names the entries that can help and their direction (`errors`). `tried` searches for each of them the value
nearest to the present one with which nothing is refused or, if there is none, with which the next refusal is about
another entry. If that refusal contradicts the change, both entries are changed together. `corrected` applies remedies
until nothing is refused.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue

from servo_tuning.braking import brake_constants
from servo_tuning.constants import time_outs
from servo_tuning.errors import EXACT, ConfigError, Problem, Remedy, Table
from servo_tuning.reading import parse
from servo_tuning.tuned import tuned

CORRECTIONS_MAX: Final = 20  # of one table

_STEPS: Final = (0.01, 0.02, 0.04, *(0.08 * k for k in range(1, 115)))
"""Logarithms of the tried factors, 1 % .. 9000. An accepted range narrower than 8 % can be missed."""
_BISECTIONS: Final = 12
_DIGITS: Final = (3, 4, 6)  # significant digits of a value, the first that is accepted

Check = Callable[[Table], Problem | None]
"""First problem of a table; None: accepted."""
Good = Callable[[Problem | None, Sequence[Remedy]], bool]
"""Whether the problem that remains after some changes is good enough."""
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
    problems: dict[Remedy, Problem | None] = field(default_factory=dict)  # of the values tried so far

    def alone(self, remedy: Remedy) -> Remedy | None:
        """The remedy with a value that is accepted."""
        return self._nearest([remedy], lambda problem, _: problem is None)

    def next(self, remedy: Remedy) -> Remedy | None:
        """The remedy with a value with which another entry has a problem, not because of this change."""
        return self._nearest([remedy], self._is_another)

    def together(self, remedy: Remedy) -> Remedy | None:
        """The remedy with a change of the entry that has a problem because of this one, if possible by one factor."""
        first = self._nearest([remedy], lambda problem, _: problem is None or problem.entry != self.entry)
        problem = None if first is None else self.problems[first]
        if first is None or problem is None:
            return first
        others = [one for one in problem.remedies if one.entry != remedy.entry]
        for one in others:
            if pair := self._nearest([replace(remedy, directions=first.directions), one], self._is_another):
                return pair
        after = _Search(applied(self.table, first, self.write), problem.entry, self.check, self.write)
        for one in others:
            if second := after.alone(one):
                return replace(first, directions=(EXACT,), also=replace(second, directions=(EXACT,)))
        return None

    def _is_another(self, problem: Problem | None, changes: Sequence[Remedy]) -> bool:
        """Whether none of the changes is refused, nor corrected by its reverse."""
        if problem is None:
            return True
        reverse = {(one.entry, -one.directions[0]) for one in changes}
        corrections = {(one.entry, direction) for one in problem.remedies for direction in one.directions}
        return problem.entry != self.entry and not reverse & corrections

    def _nearest(self, changes: Sequence[Remedy], good: Good) -> Remedy | None:
        """The changes with good values, at the smallest common factor; None if there are none."""
        if changes[0].value is not None:
            return changes[0] if self._accepted(changes[0], changes, good) else None
        found = []
        for directions in itertools.product(*(one.directions for one in changes)):
            directed = [replace(one, directions=(way,)) for one, way in zip(changes, directions, strict=True)]
            if (nearest := self._directed(directed, good)) is not None:
                found.append(nearest)
        return min(found, key=lambda pair: pair[0])[1] if found else None

    def _accepted(self, remedy: Remedy, changes: Sequence[Remedy], good: Good) -> bool:
        if remedy not in self.problems:
            self.problems[remedy] = self.check(applied(self.table, remedy, self.write))
        return good(self.problems[remedy], changes)

    def _directed(self, changes: Sequence[Remedy], good: Good) -> tuple[float, Remedy] | None:
        """Logarithm of the smallest factor with good values, and these values."""
        present = [value_in(self.table, one.entry) for one in changes]
        if any(isinstance(value, bool) or not isinstance(value, (int, float)) or not value for value in present):
            return None

        def accepted(remedy: Remedy) -> bool:
            return self._accepted(remedy, changes, good)

        def at(log: float) -> Remedy:
            values = [
                float(str(value)) * math.exp(one.directions[0] * log)
                for value, one in zip(present, changes, strict=True)
            ]
            return _with_values(changes, values)

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
        return high, next(filter(accepted, _short(changes, at(high))), at(high))


def _with_values(changes: Sequence[Remedy], values: Sequence[float]) -> Remedy:
    """The changes as one remedy; a whole number is rounded in its direction."""
    remedy: Remedy | None = None
    for one, value in reversed([*zip(changes, values, strict=True)]):
        way = one.directions[0]
        whole = float((math.ceil if way > 0 else math.floor)(value)) if one.whole else value
        # of two values each bound depends on the other one
        remedy = replace(one, value=whole, also=remedy, directions=(way,) if len(changes) == 1 else (EXACT,))
    assert remedy is not None
    return remedy


def _short(changes: Sequence[Remedy], remedy: Remedy) -> Iterator[Remedy]:
    """Values with few digits next to those of a remedy, the second of each pair beyond them."""
    values = [one.value for one in (remedy, remedy.also) if one is not None and one.value is not None]
    for digits in _DIGITS:
        nearest = [float(f"{value:.{digits}g}") for value in values]
        steps = [10.0 ** (math.floor(math.log10(abs(value))) - digits + 1) for value in values]
        beyond = [
            float(f"{value + one.directions[0] * math.copysign(step, value):.{digits}g}")
            for one, value, step in zip(changes, nearest, steps, strict=True)
        ]
        yield from (_with_values(changes, nearest), _with_values(changes, beyond))
