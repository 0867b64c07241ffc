"""Refusals of the configuration, with remedies that have been tried.

A check names the entries that can help and their direction (`higher`, `lower`, `either`). The value is computed by
trying: `remedies_tried` attaches the checked table to a refusal, and `ConfigError.remedies` searches the value nearest
to the present one with which all checks accept the table or, if there is none, with which the refusal disappears. So
every value in a message is accepted, and no check needs a second formula.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Final, cast

RAISE: Final = 1
LOWER: Final = -1
EXACT: Final = 0
_VERBS: Final[Mapping[tuple[int, ...], str]] = {(RAISE,): "raise", (LOWER,): "lower"}

_STEPS: Final = (0.01, 0.02, 0.04, *(0.08 * k for k in range(1, 30)), *(2.4 + 0.25 * k for k in range(28)))
"""Logarithms of the tried factors, 1 % .. 9000. An accepted range narrower than 8 % (28 % beyond a factor of 11) can be
missed."""
_BISECTIONS: Final = 12
_DIGITS: Final = (3, 4, 6)  # significant digits of a value, the first that is accepted

Table = Mapping[str, Any]


@dataclass(frozen=True)
class Remedy:
    """Change of one entry that removes a refusal or a warning."""

    entry: str  # full name, such as board.dead_time or axis1.motor.inertia, or an option of a program
    directions: tuple[int, ...]  # of the magnitude: `RAISE`, `LOWER`: the value or one beyond it; `EXACT`: the value
    value: float | None = None  # in the unit of the entry; None: not computed
    whole: bool = False  # whether the value is an integer

    def text(self, refused: str = "") -> str:
        """Imperative text; `refused`: entry that the sentence is about."""
        own = self.entry == refused
        if self.value is None:
            name = "it" if own else self.entry
            verb = _VERBS.get(self.directions, "correct")
            return f"{verb} {name}"
        sign = -1 if self.value < 0.0 else 1
        bound = {RAISE: " or more", LOWER: " or less", EXACT: ""}[sign * self.directions[0]]
        name = "" if own else f"{self.entry} " if self.entry.startswith("--") else f"{self.entry} = "
        return f"write {name}{self.value:g}{bound}"


def higher(entry: str, value: float | None = None) -> Remedy:
    """Remedy: raise an entry, at least to `value`."""
    return Remedy(entry, (RAISE,), value)


def lower(entry: str, value: float | None = None) -> Remedy:
    """Remedy: lower an entry, at least to `value`."""
    return Remedy(entry, (LOWER,), value)


def either(entry: str) -> Remedy:
    """Remedy: change an entry in the direction that helps."""
    return Remedy(entry, (RAISE, LOWER))


def exactly(entry: str, value: float) -> Remedy:
    """Remedy: write this value."""
    return Remedy(entry, (EXACT,), value)


class ConfigError(ValueError):
    """The configuration cannot work; the message gives the entry, its value, the reason and a remedy.

    Parameters
    ----------
    fact : str
        Entry, value and reason.
    entry : str, optional
        Full name of the refused entry, or of the quantity computed from several entries.
    remedies : sequence of Remedy, optional
        Each of them alone removes the refusal.
    advice : str, optional
        Remedy that is not a value of an entry.
    """

    def __init__(self, fact: str, entry: str = "", remedies: Sequence[Remedy] = (), advice: str = "") -> None:
        super().__init__(fact)
        self.fact, self.entry, self.advice = fact, entry, advice
        self._remedies, self._table = tuple(remedies), cast(Table, {})

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """Remedies with their values; the first access tries them."""
        if self._table:
            trial, self._table = _Trial(self._table), {}
            for whole in (True, False):
                found = [
                    one if one.value is not None else trial.of(one, None if whole else self.entry)
                    for one in self._remedies
                ]
                if any(one is not None for one in found):
                    break
            self._remedies = tuple(one for one in found if one is not None)
        return self._remedies

    def __str__(self) -> str:
        named = ", ".join(one.entry for one in self._remedies)
        texts = [one.text(self.entry) for one in self.remedies] + ([self.advice] if self.advice else [])
        if named and not texts:
            texts = [f"no other value of {named} alone is accepted"]
        return f"{self.fact}; {', or '.join(texts)}" if texts else self.fact

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.fact, self.entry, self.remedies, self.advice)

    def is_corrected_by(self, entry: str, direction: int) -> bool:
        """Whether a change of this entry in this direction is among the remedies."""
        return any(one.entry == entry and direction in one.directions for one in self._remedies)

    def offers(self, permitted: Callable[[Remedy], bool]) -> bool:
        """Whether a remedy is permitted; nothing is tried."""
        return any(map(permitted, self._remedies))

    def try_with(self, table: Table) -> None:
        """Use this table for the values of the remedies, if none has been given yet."""
        self._table = self._table or table


def refused(entry: str, value: object, reason: str, *remedies: Remedy | str) -> ConfigError:
    """Error about one entry: entry, value, reason, remedies.

    Parameters
    ----------
    entry : str
        Full name, such as ``axis1.motor.inertia``; it may be followed by its place in parentheses.
    value : object
        Its value, or a value computed from it.
    reason : str
        Why it cannot work.
    *remedies : Remedy or str
        Changes that correct it, each by itself. A text is for what is not a value of an entry.
    """
    shown = f"{value:g}" if isinstance(value, float) else f"{value}"
    changes = [one for one in remedies if isinstance(one, Remedy)]
    advice = ", or ".join(one for one in remedies if isinstance(one, str))
    return ConfigError(f"{entry} = {shown}: {reason}", re.sub(r" \(in [^)]*\)", "", entry), changes, advice)


@contextmanager
def remedies_tried(table: Table) -> Iterator[None]:
    """Context of a check of a parsed ``servo.toml``: the values of the remedies of its refusals are found by trying."""
    try:
        yield
    except ConfigError as error:
        error.try_with(table)
        raise


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


@dataclass(frozen=True)
class _Trial:
    """Search of values by trying."""

    table: Table  # refused one

    def of(self, remedy: Remedy, refused_entry: str | None) -> Remedy | None:
        """The remedy with the accepted value that is nearest to the present one; None if no value is accepted.

        With `refused_entry`, a value is accepted, too, with which another entry is refused, not because of this change.
        """
        present = value_in(self.table, remedy.entry)
        if isinstance(present, bool) or not isinstance(present, (int, float)) or not present:
            return None
        found = []
        for direction in remedy.directions:
            value = self._search(remedy, direction, float(present), refused_entry)
            if value is not None:
                distance = abs(math.log(value / present)) if value / present > 0.0 else math.inf
                found.append((distance, replace(remedy, directions=(direction,), value=value)))
        return min(found, key=lambda pair: pair[0])[1] if found else None

    def _search(self, remedy: Remedy, direction: int, present: float, refused_entry: str | None) -> float | None:
        from servo_tuning.acceptance import refusal_of  # which raises errors of this module

        outcomes: dict[float, ConfigError | None] = {}

        def outcome(value: float) -> ConfigError | None:
            """Refusal of this value; None: accepted."""
            if value not in outcomes:
                changed = with_value(self.table, remedy.entry, int(value) if remedy.whole else value)
                outcomes[value] = refusal_of(changed)
            return outcomes[value]

        def at(log: float) -> float:
            value = present * math.exp(direction * log)
            return float((math.ceil if direction > 0 else math.floor)(value)) if remedy.whole else value

        def good(value: float) -> bool:
            error = outcome(value)
            if error is None or refused_entry is None:
                return error is None
            return error.entry != refused_entry and not error.is_corrected_by(remedy.entry, -direction)

        before = 0.0
        for log in _STEPS:
            if good(at(log)):
                return self._nearest(good, at, (before, log), direction)
            before = log
        return None

    def _nearest(
        self, good: Callable[[float], bool], at: Callable[[float], float], span: tuple[float, float], direction: int
    ) -> float:
        """Accepted value next to the boundary between a refused and an accepted one, with few digits."""
        low, high = span
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if good(at(middle)) else (middle, high)
        value = at(high)
        for digits in _DIGITS:
            nearest = float(f"{value:.{digits}g}")
            beyond = nearest + direction * math.copysign(
                10.0 ** (math.floor(math.log10(abs(value))) - digits + 1), value
            )
            for short in (nearest, float(f"{beyond:.{digits}g}")):
                if good(short):
                    return short
        return value
