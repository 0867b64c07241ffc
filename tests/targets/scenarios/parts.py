"""What the scenarios share: quiet motors, features and faults by name, an axis that is ready, spins or has stopped."""

from __future__ import annotations

import math
from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue
from servo_twin.plant import PlantConfig

from targets.rig import Rig

POSITION: Final = 0
SPEED: Final = 1
TORQUE: Final = 2
TRAJECTORY: Final = 3
TEST: Final = 4

COAST: Final = 0
SHORT: Final = 1
RAMP: Final = 2
HOLD: Final = 3

FAR: Final = 2**30 - 2**20
"""A position, in counts, almost as far away as the board lets an axis be sent."""

_FEATURES: Final = {flag.name: flag.mask for flag in Catalogue.load().flags["features"]}
_REFERENCE_DESIGN: Final = sum(
    _FEATURES[name] for name in ("ANTI_WINDUP", "ENHANCED_MT", "BUS_COMPENSATION", "DEAD_TIME")
)
ALL_FAULTS: Final = sum(flag.mask for flag in Catalogue.load().flags["faults"])
BLIND: Final = sum(
    flag.mask
    for flag in Catalogue.load().flags["faults"]
    if flag.name not in ("CURRENT_SENSE", "PHASE_LOST", "ENCODER_LOST", "ANGLE_MISMATCH")
)
"""Faults of an axis that shall bear senseless inputs."""
_QUICK: Final = (0.0, math.pi / 4)
"""Rotor angles that are found soon [rad]."""


def plant(theta: tuple[float, float] = _QUICK, capacitance: float = 4.7e-3, **axis: Any) -> PlantConfig:
    """Motors of the packaged description, with quieter sensors, which make short recordings."""
    quiet = PlantConfig.load().with_bus(u_noise=0.005, capacitance=capacitance)
    for index in range(2):
        quiet = quiet.with_axis(index, **{"i_noise": 0.002, "theta_start": theta[index], **axis})
    return quiet


def ends(name: str) -> tuple[int, int]:
    """Lowest and highest raw number that may be written."""
    return Catalogue.load()[name].raw_range


def features(*names: str) -> int:
    """Features of the reference design and those named."""
    return _REFERENCE_DESIGN + sum(_FEATURES[name] for name in names)


def ready(rig: Rig) -> None:
    """Wait for the end of the start; set-points stand until the next one."""
    rig.set("param.command_timeout", 0.0)
    rig.until("STOP after reset", lambda: rig.places() == ["STOP", "STOP"])


def spin(rig: Rig) -> None:
    """Switch both axes on and wait until they hold their position."""
    ready(rig)
    rig.set("cmd.enable", 1)
    rig.until("SPIN on both axes", lambda: rig.places() == ["SPIN", "SPIN"])


def stop(rig: Rig) -> None:
    """Switch both axes off and wait until they rest."""
    rig.set("cmd.enable", 0)
    rig.until("STOP", lambda: rig.places() == ["STOP", "STOP"])
