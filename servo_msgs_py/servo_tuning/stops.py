"""Stop categories of commands and faults: the group [stop] of a configuration."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, MutableMapping
from dataclasses import dataclass
from typing import Any, Final

from servo_msgs_py.stop_categories import CATEGORIES, REFUSED

from servo_tuning.errors import Entry, refused
from servo_tuning.schema import unknown_name

COMMANDS: Final = ("disable", "quick_stop")
"""Commands that stop an axis; the file must have a category for each."""


@dataclass(frozen=True)
class Stops:
    """The categories of the group [stop]."""

    commands: Mapping[str, str]  # category by command
    faults: Mapping[str, str]  # category by fault, lower case; a fault without one coasts

    @classmethod
    def extract(
        cls,
        group: MutableMapping[str, Any],
        fault_names: Collection[str],
        place: Callable[[str], Entry],
        numbers: Collection[str],
    ) -> Stops:
        """Remove the categories from the group, so that only its numbers remain.

        Parameters
        ----------
        group : mutable mapping
            Parsed group; modified.
        fault_names : collection of str
            Faults of the contract, lower case.
        place : callable
            Returns an entry by its key, for messages.
        numbers : collection of str
            Keys that are not categories.

        Raises
        ------
        ConfigError
            If a name is unknown, a command missing, or a category impossible.
        """
        known = (*COMMANDS, *fault_names)
        found: dict[str, str] = {}
        for key in [key for key in group if key not in numbers]:
            if key not in known:
                raise unknown_name(place(key), key, (*known, *numbers))
            found[key] = _category(place(key), key, group.pop(key))
        for command in COMMANDS:
            if command not in found:
                raise refused(place(command), "nothing", "every command needs a category", _remedy(CATEGORIES))
        commands = {key: found.pop(key) for key in COMMANDS}
        return cls(commands, found)

    def faults_with(self, category: str) -> list[str]:
        """Faults with this category, lower case, sorted."""
        return sorted(fault for fault, how in self.faults.items() if how == category)


def _remedy(categories: Collection[str]) -> str:
    return f"write {' or '.join(categories)}"


def _category(entry: Entry, key: str, value: object) -> str:
    if not isinstance(value, str) or value not in CATEGORIES:
        raise refused(entry, repr(value), "not a stop category", _remedy(CATEGORIES))
    no = REFUSED.get(key, {})
    if value in no:
        raise refused(entry, value, no[value], _remedy([one for one in CATEGORIES if one not in no]))
    return value
