"""Parts of a configuration block that only a feature, or operation without an encoder, needs.

An axis that does not use a part is not refused because of it: where the part cannot work, its members are off, and a
board refuses to switch it on (``firmware/drive/axis_data.h``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from servo_tuning.configuration import Axis
from servo_tuning.constants import friction_constants, speed_observer_constants
from servo_tuning.conversion import Converter, Field, Value, rounded
from servo_tuning.sensorless_constants import OFF, needs_observer, sensorless_constants


@dataclass(frozen=True)
class OptionalPart:
    """A part of the block."""

    needed_for: str  # what cannot be used without it, for messages
    used: Callable[[Axis], bool]  # whether an axis needs it after reset
    constants: Callable[[Converter], dict[str, Value]]  # its fields; raises ConfigError if it cannot work
    off: Mapping[str, Field]  # its fields while it is off

    def fields(self, to: Converter) -> dict[str, Field]:
        """Fields that a board accepts.

        Raises
        ------
        ConfigError
            If the part cannot work.
        """
        return rounded(self.constants(to))


_OBSERVER_GAINS: Final = ("l_position", "l_speed", "l_acceleration")

SENSORLESS: Final = "sensorless"
SPEED_OBSERVER: Final = "speed observer"

PARTS: Final[Mapping[str, OptionalPart]] = {
    SENSORLESS: OptionalPart(
        "operation without an encoder (feedback OBSERVER) and the feature ANGLE_CHECK",
        needs_observer,
        sensorless_constants,
        OFF,
    ),
    SPEED_OBSERVER: OptionalPart(
        "the feature SPEED_OBSERVER",
        lambda axis: axis.features["speed_observer"],
        speed_observer_constants,
        dict.fromkeys((f"speed_observer.{key}" for key in _OBSERVER_GAINS), 0),
    ),
    "friction": OptionalPart(
        "the feature FRICTION",
        lambda axis: axis.features["friction"],
        friction_constants,
        {"friction.coulomb": 0, "friction.viscous": 0, "friction.smooth": 1, "friction.slope": 0},
    ),
}
"""All optional parts, by name."""
