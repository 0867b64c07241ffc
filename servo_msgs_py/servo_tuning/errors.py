"""What is wrong with a configuration: fact, refused entry, and the entries that can correct it.

A check names the entries that can help and their direction (`higher`, `lower`, `either`); `remedies` computes the
values by trying.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

RAISE: Final = 1
LOWER: Final = -1
EXACT: Final = 0
_VERBS: Final[Mapping[tuple[int, ...], str]] = {(RAISE,): "raise", (LOWER,): "lower"}

Table = Mapping[str, Any]


@dataclass(frozen=True)
class Entry:
    """Place of a value in a configuration, for messages."""

    name: str  # full name, such as axis1.motor.inertia
    group: str = ""  # group of [defaults] that has the entry; empty: the axis itself
    quantity: str = ""  # what is computed from the entry; empty: the entry itself

    @property
    def subject(self) -> str:
        """Name of the entry, or of the quantity computed from it."""
        return f"{self.name}: {self.quantity}" if self.quantity else self.name

    def __str__(self) -> str:
        place = f" (in [defaults.{self.group}])" if self.group else ""
        return f"{self.name}{place}: {self.quantity}" if self.quantity else f"{self.name}{place}"


@dataclass(frozen=True)
class Remedy:
    """Change of an entry that removes a refusal or a warning."""

    entry: str  # full name, such as board.dead_time or axis1.motor.inertia, or an option of a program
    directions: tuple[int, ...]  # of the magnitude: `RAISE`, `LOWER`: the value or one beyond it; `EXACT`: the value
    value: float | None = None  # in the unit of the entry; None: not computed
    whole: bool = False  # whether the value is an integer
    also: Remedy | None = None  # change that is necessary besides

    def text(self, refused: str = "") -> str:
        """Imperative text; `refused`: entry that the sentence is about."""
        own = self.entry == refused
        if self.value is None:
            verb = _VERBS.get(self.directions, "correct")
            return f"{verb} {'it' if own else self.entry}"
        return f"write {self._number() if own and self.also is None else self._assignment()}"

    def _number(self) -> str:
        assert self.value is not None, self.entry
        sign = -1 if self.value < 0.0 else 1
        bound = {RAISE: " or more", LOWER: " or less", EXACT: ""}[sign * self.directions[0]]
        return f"{self.value:g}{bound}"

    def _assignment(self) -> str:
        other = f" and {self.also._assignment()}" if self.also is not None else ""
        return f"{self.entry}{' ' if self.entry.startswith('--') else ' = '}{self._number()}{other}"


def higher(entry: str, value: float | None = None) -> Remedy:
    """Remedy: raise an entry, at least to `value`."""
    return Remedy(entry, (RAISE,), value)


def lower(entry: str, value: float | None = None) -> Remedy:
    """Remedy: lower an entry, at least to `value`."""
    return Remedy(entry, (LOWER,), value)


def either(entry: str) -> Remedy:
    """Remedy: change an entry in the direction that helps."""
    return Remedy(entry, (RAISE, LOWER))


def raised(wanted: Mapping[str, tuple[float, float]]) -> Remedy | None:
    """Remedy of several entries, all of them necessary: present and wanted value by name; None if all suffice."""
    remedy: Remedy | None = None
    for entry, (present, value) in reversed([*wanted.items()]):
        if value > present:
            remedy = Remedy(entry, (RAISE,), value, also=remedy)
    return remedy


def exactly(entry: str, value: float) -> Remedy:
    """Remedy: write this value."""
    return Remedy(entry, (EXACT,), value)


@dataclass(frozen=True)
class Problem:
    """Reason of a refusal or a warning, with its remedies."""

    fact: str  # entry, value and reason
    entry: str = ""  # full name of the entry, or of the quantity computed from several entries
    remedies: tuple[Remedy, ...] = ()  # each of them alone removes the problem
    advice: str = ""  # remedy that is not a value of an entry

    def __str__(self) -> str:
        texts = [one.text(self.entry) for one in self.remedies] + ([self.advice] if self.advice else [])
        return f"{self.fact}; {', or '.join(texts)}" if texts else self.fact


def problem(entry: Entry | str, value: object, reason: str, *remedies: Remedy | str) -> Problem:
    """Problem of one entry: entry, value, reason, remedies.

    Parameters
    ----------
    entry : Entry or str
        The entry, or its full name, such as ``axis1.motor.inertia``.
    value : object
        Its value, or a value computed from it.
    reason : str
        Why it cannot work.
    *remedies : Remedy or str
        Changes that correct it, each by itself. A text is for what is not a value of an entry.
    """
    shown = f"{value:g}" if isinstance(value, float) else f"{value}"
    changes = tuple(one for one in remedies if isinstance(one, Remedy))
    advice = ", or ".join(one for one in remedies if isinstance(one, str))
    subject = entry.subject if isinstance(entry, Entry) else entry
    return Problem(f"{entry} = {shown}: {reason}", subject, changes, advice)


class ConfigError(ValueError):
    """The configuration cannot work; the message gives the entry, its value, the reason and a remedy."""

    def __init__(self, problem: Problem | str) -> None:
        self.problem = problem if isinstance(problem, Problem) else Problem(problem)
        self.table: Table = {}  # checked ``servo.toml``, if known
        super().__init__(str(self.problem))


def refused(entry: Entry | str, value: object, reason: str, *remedies: Remedy | str) -> ConfigError:
    """Error about one entry; arguments as for `problem`."""
    return ConfigError(problem(entry, value, reason, *remedies))


@contextmanager
def checking(table: Table) -> Iterator[None]:
    """Context of a check of a parsed ``servo.toml``: its errors have the table, with which remedies can be tried."""
    try:
        yield
    except ConfigError as error:
        error.table = error.table or table
        raise
