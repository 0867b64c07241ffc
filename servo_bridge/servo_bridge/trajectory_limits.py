"""Limits that a path has to keep: those of the board and those of the configuration, the tighter ones. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from servo_msgs_py.board_parameters import RawParameters
from servo_msgs_py.catalogue import Catalogue

from servo_bridge.arbiter import JointLimits
from servo_bridge.trajectory.check import Limits

__all__ = ["path_limits"]


def path_limits(
    catalogue: Catalogue, raw: RawParameters, joints: Sequence[JointLimits], torque_constants: Sequence[float]
) -> list[Limits]:
    """Limits of every joint.

    Parameters
    ----------
    catalogue : Catalogue
        Scales of the parameters, and the bit of the feature POSITION_LIMITS.
    raw : mapping
        Parameters of the board.
    joints : sequence of JointLimits
        Of the configuration.
    torque_constants : sequence of float
        [N m/A]
    """
    confine = next(flag.mask for flag in catalogue.flags["features"] if flag.name == "POSITION_LIMITS")
    values = _si(catalogue, raw)
    limits: list[Limits] = []
    for axis, joint in enumerate(joints):
        confined = bool(raw["param.features"][axis] & confine)
        limits.append(
            Limits(
                position_min=max(joint.position_min, values["param.position_min"][axis] if confined else -math.inf),
                position_max=min(joint.position_max, values["param.position_max"][axis] if confined else math.inf),
                velocity_max=min(joint.velocity_max, values["param.speed_limit"][axis]),
                acceleration_max=values["param.acceleration_limit"][axis],
                torque_max=min(joint.effort_max, values["param.i_q_limit"][axis] * torque_constants[axis]),
            )
        )
    return limits


def _si(catalogue: Catalogue, raw: RawParameters) -> Mapping[str, list[float]]:
    return {name: [number * catalogue[name].lsb for number in numbers] for name, numbers in raw.items()}
