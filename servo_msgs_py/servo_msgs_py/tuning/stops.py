"""Stop categories of commands and faults, and the combinations that are refused."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, MutableMapping
from dataclasses import dataclass
from typing import Any, Final

from servo_msgs_py.tuning.errors import refused
from servo_msgs_py.tuning.schema import unknown_name

CATEGORIES: Final = ("coast", "short", "ramp", "hold")
"""From the harshest to the gentlest. A category that is not possible at the moment is replaced by the previous one."""

COMMANDS: Final = ("disable", "quick_stop")
"""Commands that stop an axis; the file must have a category for each."""

_SWITCHES: Final = "the hardware has opened the switches, or one of them may be broken"
_ANGLE: Final = "the angle of the rotor is not valid"
_CURRENT: Final = "the measured currents are not valid"
_SPEED: Final = "the speed is not known, which determines the current of the short circuit"
_IDLE: Final = "the shaft is not under control when this fault occurs"
_LATE: Final = "the control loops do not run reliably"
_BUS: Final = "regeneration would raise the bus voltage further"
_WEAK: Final = "the bus voltage is too low for gate drivers and current control"
_HEAT: Final = "position hold heats the winding further"
_HELD: Final = "the shaft is blocked, or its encoder has failed"

_CONTROLLED: Final = ("ramp", "hold")
_BRAKING: Final = ("short", *_CONTROLLED)


def _because(reason: str, categories: Collection[str]) -> dict[str, str]:
    return dict.fromkeys(categories, reason)


REFUSED: Final[Mapping[str, Mapping[str, str]]] = {
    "over_voltage": _because(_BUS, _CONTROLLED),
    "under_voltage": _because(_WEAK, _BRAKING),
    "over_current": _because(_SWITCHES, _BRAKING),
    "current_offset": _because(_IDLE, _BRAKING),
    "rotor_search": _because(_IDLE, _BRAKING),
    "encoder": _because(_ANGLE, _CONTROLLED) | _because(_SPEED, ["short"]),
    "stalled": _because(_HELD, _BRAKING),
    "runaway": _because(_ANGLE, _CONTROLLED),
    "encoder_lost": _because(_ANGLE, _CONTROLLED) | _because(_SPEED, ["short"]),
    "encoder_reversed": _because(_IDLE, _BRAKING),
    "over_temperature": _because(_HEAT, ["hold"]),
    "motor_temperature": _because(_HEAT, ["hold"]),
    "start_up": _because(_IDLE, _BRAKING),
    "speed_feedback": _because(_ANGLE, _CONTROLLED) | _because(_SPEED, ["short"]),
    "angle_mismatch": _because(_ANGLE, _CONTROLLED),
    "phase_lost": _because(_CURRENT, _BRAKING),
    "current_sense": _because(_CURRENT, _BRAKING),
    "enable_input": _because(_SWITCHES, _BRAKING),
    "late_loop": _because(_LATE, _BRAKING),
    "watchdog": _because(_LATE, _BRAKING),
}
"""Refused categories by fault, each with the reason; any other combination is permitted."""


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
        place: Callable[[str], str],
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
            Returns the full name of an entry, for messages.
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


def _category(entry: str, key: str, value: object) -> str:
    if not isinstance(value, str) or value not in CATEGORIES:
        raise refused(entry, repr(value), "not a stop category", _remedy(CATEGORIES))
    no = REFUSED.get(key, {})
    if value in no:
        raise refused(entry, value, no[value], _remedy([one for one in CATEGORIES if one not in no]))
    return value
