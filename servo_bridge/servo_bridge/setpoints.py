"""Set-points as they arrive: what a message asks for, checked for form.

Form means everything that can be said without knowing the board: names, lengths, which array is filled, finite
numbers. Limits and states are the arbiter's business. Pure; takes plain sequences, so no ROS message is needed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

__all__ = ["Mode", "Rejected", "Request", "from_array", "from_joint_command", "from_single"]


class Rejected(ValueError):
    """A command that was not carried out; the text says what is wrong, where, and what to do."""


class Mode(IntEnum):
    """What the set-point of an axis means; the numbers are those of ``cmd.mode``."""

    POSITION = 0
    SPEED = 1
    TORQUE = 2
    TRAJECTORY = 3


@dataclass(frozen=True)
class Request:
    """A well-formed command.

    Attributes
    ----------
    source : str
        Topic that it came from.
    mode : Mode
        Meaning of the values.
    values : mapping
        Axis index to set-point: [rad], [rad/s] or [N m], by `mode`.
    """

    source: str
    mode: Mode
    values: Mapping[int, float]


_FIELDS = {"position": Mode.POSITION, "velocity": Mode.SPEED, "effort": Mode.TORQUE}


def from_joint_command(
    source: str,
    joints: Sequence[str],
    names: Sequence[str],
    position: Sequence[float],
    velocity: Sequence[float],
    effort: Sequence[float],
) -> Request:
    """Command of a JointState: joints by name, the mode by the one array that is filled.

    Raises
    ------
    Rejected
        If a name is unknown or given twice, no or several arrays are filled, a length is wrong or a number is not
        finite.
    """
    listing = ", ".join(joints)
    if not names:
        raise Rejected(f"{source}: name is empty; name the joints to move ({listing})")
    for name in names:
        if name not in joints:
            raise Rejected(f"{source}: joint {name!r} does not exist; the joints are {listing}")
    if len(set(names)) != len(names):
        raise Rejected(f"{source}: a joint is named twice in {', '.join(names)}; name each joint once")
    arrays = {"position": position, "velocity": velocity, "effort": effort}
    filled = [field for field, values in arrays.items() if len(values)]
    if len(filled) != 1:
        found = " and ".join(filled) if filled else "none"
        raise Rejected(f"{source}: fill exactly one of position, velocity and effort; filled: {found}")
    field = filled[0]
    values = arrays[field]
    if len(values) != len(names):
        raise Rejected(f"{source}: {field} has {len(values)} values for {len(names)} names; give one value per name")
    for name, value in zip(names, values, strict=True):
        _check_finite(source, f"{field} of {name}", value)
    pairs = {joints.index(name): float(value) for name, value in zip(names, values, strict=True)}
    return Request(source, _FIELDS[field], pairs)


def from_array(source: str, joints: Sequence[str], data: Sequence[float]) -> Request:
    """Positions of all joints in joint order [rad].

    Raises
    ------
    Rejected
        If the length is not the number of joints or a number is not finite.
    """
    if len(data) != len(joints):
        order = ", ".join(joints)
        raise Rejected(
            f"{source}: {len(data)} values given, {len(joints)} expected; give one position per joint ({order})"
        )
    for name, value in zip(joints, data, strict=True):
        _check_finite(source, f"position of {name}", value)
    return Request(source, Mode.POSITION, {axis: float(value) for axis, value in enumerate(data)})


def from_single(source: str, axis: int, value: float) -> Request:
    """Position of one joint [rad].

    Raises
    ------
    Rejected
        If the number is not finite.
    """
    _check_finite(source, "position", value)
    return Request(source, Mode.POSITION, {axis: float(value)})


def _check_finite(source: str, what: str, value: float) -> None:
    if not math.isfinite(value):
        raise Rejected(f"{source}: {what} is {value}; send a finite number")
