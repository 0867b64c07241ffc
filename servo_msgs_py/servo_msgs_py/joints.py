"""Joints and the motors behind them: gear ratio, direction, offset, limits. Pure.

Everything on ROS that names a joint is in joint units; the variables of the board are in motor units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from servo_msgs_py.catalogue import AXES, axis_name

GEAR_RATIO_MIN: Final = 1.0e-4
GEAR_RATIO_MAX: Final = 1.0e5
OFFSET_MAX: Final = 1.0e6
"""Largest magnitude of an offset [rad]; with the largest gear ratio a count of the motor is still resolved."""

_Number = TypeVar("_Number", float, NDArray[np.float64])


@dataclass(frozen=True)
class JointLimits:
    """Limits of one joint on top of those of the board; infinite where there are none."""

    position_min: float = -math.inf  # [rad]
    position_max: float = math.inf  # [rad]
    velocity_max: float = math.inf  # magnitude [rad/s]
    effort_max: float = math.inf  # magnitude [N m]

    @property
    def bounded(self) -> bool:
        """Whether a position is limited; a joint without such a limit is continuous."""
        return self.position_min > -math.inf or self.position_max < math.inf


@dataclass(frozen=True)
class Joint:
    """A joint that a motor drives by a gear. Values of the default gear are those of the motor, unchanged.

    joint position = motor position / `reduction` + `offset`

    Raises
    ------
    ValueError
        If the gear ratio, the direction or the offset is outside its range.
    """

    name: str  # name on ROS
    gear_ratio: float = 1.0  # turns of the motor per turn of the joint, `GEAR_RATIO_MIN` .. `GEAR_RATIO_MAX`
    direction: int = 1  # 1, or -1 where the joint turns the other way than the motor
    offset: float = 0.0  # position of the joint where the motor is at 0 [rad]
    limits: JointLimits = field(default_factory=JointLimits)  # in joint units

    def __post_init__(self) -> None:
        if not GEAR_RATIO_MIN <= self.gear_ratio <= GEAR_RATIO_MAX:
            raise ValueError(
                f"gear_ratio of {self.name} is {self.gear_ratio:g}; give turns of the motor per turn of the joint, "
                f"{GEAR_RATIO_MIN:g} .. {GEAR_RATIO_MAX:g}"
            )
        if self.direction not in (1, -1):
            raise ValueError(f"direction of {self.name} is {self.direction}; give 1, or -1 to reverse it")
        if not abs(self.offset) <= OFFSET_MAX:
            raise ValueError(
                f"offset of {self.name} is {self.offset:g} rad; give the position of the joint where the motor is at "
                f"0, {-OFFSET_MAX:.0f} .. {OFFSET_MAX:.0f} rad"
            )

    @property
    def reduction(self) -> float:
        """Gear ratio with the sign of the direction."""
        return self.direction * self.gear_ratio

    # ---- motor to joint
    def position(self, motor: _Number) -> _Number:
        """Joint position [rad]."""
        return motor / self.reduction + self.offset

    def velocity(self, motor: _Number) -> _Number:
        """Joint velocity [rad/s]; in the same way an acceleration, or a difference of positions."""
        return motor / self.reduction

    def effort(self, motor: _Number) -> _Number:
        """Joint torque [N m]."""
        return motor * self.reduction

    # ---- joint to motor
    def motor_position(self, position: _Number) -> _Number:
        """Motor position [rad]."""
        return (position - self.offset) * self.reduction

    def motor_velocity(self, velocity: _Number) -> _Number:
        """Motor velocity [rad/s]; in the same way an acceleration."""
        return velocity * self.reduction

    def motor_effort(self, effort: _Number) -> _Number:
        """Motor torque [N m]."""
        return effort / self.reduction


DEFAULT_JOINTS: Final = tuple(Joint(axis_name(axis)) for axis in range(AXES))
"""The shafts of the motors themselves."""


def joint_names(joints: Sequence[Joint]) -> list[str]:
    """Names in the order of the axes."""
    return [joint.name for joint in joints]
