"""Joints and their motors: gear ratio, direction, offset, limits.

All joint quantities on ROS are in joint units; the variables of the board are in motor units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from servo_msgs_py.catalogue import AXES, axis_name

GEAR_RATIO_MIN: Final = 1.0e-4
GEAR_RATIO_MAX: Final = 1.0e5
OFFSET_MAX: Final = 1.0e6
"""Largest magnitude of an offset [rad]; the resolution is one count of the motor even at the largest gear ratio."""

_Number = TypeVar("_Number", float, NDArray[np.float64])


@dataclass(frozen=True)
class JointLimits:
    """Limits of one joint in addition to the limits of the board; infinite if not limited."""

    position_min: float = -math.inf  # [rad]
    position_max: float = math.inf  # [rad]
    velocity_max: float = math.inf  # magnitude [rad/s]
    effort_max: float = math.inf  # magnitude [N m]

    @property
    def bounded(self) -> bool:
        """Whether the position is limited."""
        return self.position_min > -math.inf or self.position_max < math.inf


@dataclass(frozen=True)
class Joint:
    """Joint driven by a motor through a gear. With the default gear, joint and motor values are equal.

    joint position = motor position / `reduction` + `offset`

    A joint counts its turns, unless it `wraps`: then its position is an angle, and positions that differ by whole turns
    are the same place.

    Raises
    ------
    ValueError
        If the gear ratio, the direction or the offset is outside its range, or a joint that wraps has position limits.
    """

    name: str  # name on ROS
    gear_ratio: float = 1.0  # motor revolutions per joint revolution, `GEAR_RATIO_MIN` .. `GEAR_RATIO_MAX`
    direction: int = 1  # 1; -1: joint and motor rotate in opposite directions
    offset: float = 0.0  # joint position at motor position 0 [rad]
    limits: JointLimits = field(default_factory=JointLimits)  # in joint units
    wraps: bool = False  # whether positions are angles within -pi .. pi
    used: bool = True  # whether a motor is connected; otherwise the axis is never enabled

    def __post_init__(self) -> None:
        if not GEAR_RATIO_MIN <= self.gear_ratio <= GEAR_RATIO_MAX:
            raise ValueError(
                f"gear_ratio of {self.name} is {self.gear_ratio:g}; give motor revolutions per joint revolution, "
                f"{GEAR_RATIO_MIN:g} .. {GEAR_RATIO_MAX:g}"
            )
        if self.direction not in (1, -1):
            raise ValueError(f"direction of {self.name} is {self.direction}; give 1, or -1 to reverse it")
        if not abs(self.offset) <= OFFSET_MAX:
            raise ValueError(
                f"offset of {self.name} is {self.offset:g} rad; give the joint position at motor position "
                f"0, {-OFFSET_MAX:.0f} .. {OFFSET_MAX:.0f} rad"
            )
        if self.wraps and self.limits.bounded:
            raise ValueError(
                f"wraps of {self.name} is true, but it has position limits, which an angle that wraps cannot keep; "
                "remove position_min and position_max of this joint, or write false"
            )

    @cached_property
    def reduction(self) -> float:
        """Gear ratio with the sign of the direction."""
        return self.direction * self.gear_ratio

    # ---- motor to joint
    def position(self, motor: _Number) -> _Number:
        """Joint position [rad]."""
        return motor / self.reduction + self.offset

    def velocity(self, motor: _Number) -> _Number:
        """Joint velocity [rad/s]; also for accelerations and differences of positions."""
        return motor / self.reduction

    def effort(self, motor: _Number) -> _Number:
        """Joint torque [N m]."""
        return motor * self.reduction

    # ---- joints that wrap
    def reported(self, position: _Number) -> _Number:
        """Position as published [rad]: within -pi .. pi if the joint wraps, otherwise unchanged."""
        return (position + math.pi) % math.tau - math.pi if self.wraps else position

    def nearest(self, position: float, reference: float) -> float:
        """The place `position` by the shortest way from `reference` [rad]; `position` itself unless the joint wraps."""
        return position + math.tau * round((reference - position) / math.tau) if self.wraps else position

    # ---- joint to motor
    def motor_position(self, position: _Number) -> _Number:
        """Motor position [rad]."""
        return (position - self.offset) * self.reduction

    def motor_velocity(self, velocity: _Number) -> _Number:
        """Motor velocity [rad/s]; also for accelerations."""
        return velocity * self.reduction

    def motor_effort(self, effort: _Number) -> _Number:
        """Motor torque [N m]."""
        return effort / self.reduction


DEFAULT_JOINTS: Final = tuple(Joint(axis_name(axis)) for axis in range(AXES))
"""The motor shafts."""


def joint_names(joints: Sequence[Joint]) -> list[str]:
    """Names in the order of the axes."""
    return [joint.name for joint in joints]
