"""Limits of a path in joint units: the tighter of the limits of the board and of the joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import Joint
from servo_msgs_py.robot_description import Motor

from servo_bridge.trajectory.check import Limits


def path_limits(
    catalogue: Catalogue, raw: RawParameters, joints: Sequence[Joint], motors: Sequence[Motor]
) -> list[Limits]:
    """Return the limits of every joint.

    Parameters
    ----------
    catalogue : Catalogue
        Scales of the parameters, and the bit of the feature POSITION_LIMITS.
    raw : mapping
        Parameters of the board.
    joints : sequence of Joint
        In the order of the axes.
    motors : sequence of Motor
        In the order of the axes; empty if not known: then the torque is not limited.
    """
    confine = catalogue.flag("features", "POSITION_LIMITS").mask
    values = _si(catalogue, raw)
    limits: list[Limits] = []
    for axis, joint in enumerate(joints):
        confined = bool(raw["param.features"][axis] & confine)
        ends = sorted(joint.position(values[f"param.position_{end}"][axis]) for end in ("min", "max"))
        low, high = ends if confined else (-math.inf, math.inf)
        own = joint.limits
        motor = motors[axis] if motors else Motor(math.inf, 0.0)
        limits.append(
            Limits(
                position_min=max(own.position_min, low),
                position_max=min(own.position_max, high),
                velocity_max=min(own.velocity_max, abs(joint.velocity(values["param.speed_limit"][axis]))),
                acceleration_max=abs(joint.velocity(values["param.acceleration_limit"][axis])),
                torque_max=min(
                    own.effort_max, abs(joint.effort(values["param.i_q_limit"][axis] * motor.torque_constant))
                ),
                inertia=motor.inertia * joint.gear_ratio**2,
            )
        )
    return limits


def _si(catalogue: Catalogue, raw: RawParameters) -> Mapping[str, list[float]]:
    return {name: [number * catalogue[name].lsb for number in numbers] for name, numbers in raw.items()}
