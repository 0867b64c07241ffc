"""Shared parts of the scenarios: motors with low noise, features and faults by name, start and stop of both axes."""

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
"""A position close to the largest permitted distance [counts]."""

_FEATURES: Final = {flag.name: flag.mask for flag in Catalogue.load().flags["features"]}
_REFERENCE_DESIGN: Final = sum(
    _FEATURES[name] for name in ("ANTI_WINDUP", "ENHANCED_MT", "BUS_COMPENSATION", "DEAD_TIME")
)
ALL_FAULTS: Final = sum(flag.mask for flag in Catalogue.load().flags["faults"])
FAULTS_WITHOUT_MONITORS: Final = sum(
    flag.mask
    for flag in Catalogue.load().flags["faults"]
    if flag.name not in ("CURRENT_SENSE", "PHASE_LOST", "ENCODER_LOST", "ANGLE_MISMATCH")
)
"""Enabled faults of an axis with random inputs."""
_SHORT_SEARCH: Final = (0.0, math.pi / 4)
"""Rotor angles with a short rotor search [rad]."""


def plant(theta: tuple[float, float] = _SHORT_SEARCH, capacitance: float = 4.7e-3, **axis: Any) -> PlantConfig:
    """Packaged plant with less sensor noise, for short recordings."""
    plant_config = PlantConfig.load().with_bus(u_noise=0.005, capacitance=capacitance)
    for index in range(2):
        plant_config = plant_config.with_axis(index, **{"i_noise": 0.002, "theta_start": theta[index], **axis})
    return plant_config


def raw_range(name: str) -> tuple[int, int]:
    """Smallest and largest permitted raw number."""
    return Catalogue.load()[name].raw_range


def features(*names: str) -> int:
    """Mask of the features of the reference design and of the given ones."""
    return _REFERENCE_DESIGN + sum(_FEATURES[name] for name in names)


def ready(rig: Rig) -> None:
    """Wait for STOP after reset; set-points do not expire."""
    rig.set("param.command_timeout", 0.0)
    rig.until("STOP after reset", lambda: rig.states() == ["STOP", "STOP"])


def spin(rig: Rig) -> None:
    """Enable both axes and wait until they hold their positions."""
    ready(rig)
    rig.set("cmd.enable", 1)
    rig.until("SPIN on both axes", lambda: rig.states() == ["SPIN", "SPIN"])


def stop(rig: Rig) -> None:
    """Disable both axes and wait for STOP."""
    rig.set("cmd.enable", 0)
    rig.until("STOP", lambda: rig.states() == ["STOP", "STOP"])
