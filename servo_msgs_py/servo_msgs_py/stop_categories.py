"""How an axis can be stopped, and which fault rules out which category."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

CATEGORIES: Final = ("coast", "short", "ramp", "hold")
"""From the harshest to the gentlest. A category that is not possible at the moment is replaced by the previous one."""

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
