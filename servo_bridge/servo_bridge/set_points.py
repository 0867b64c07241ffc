"""Set-points of messages: parsing and checks that do not depend on the board.

Checked here: names, array lengths, which array is used, finite numbers. Limits and states are checked by the arbiter.
Uses sequences, not ROS messages.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum


class Rejected(ValueError):
    """A command was refused; the text has the error, its location and a remedy."""

    kind = ""
    """Refusals of the same kind that follow each other are logged once; empty: each one."""


class NotReady(Rejected):
    """The axes do not accept set-points at present."""

    def __init__(self, text: str, kind: str = "") -> None:
        super().__init__(text)
        self.kind = kind or text


class Mode(IntEnum):
    """Meaning of a set-point; values as in ``cmd.mode``."""

    POSITION = 0
    SPEED = 1
    TORQUE = 2
    TRAJECTORY = 3


@dataclass(frozen=True)
class SetPointRequest:
    """Command with valid form."""

    source: str  # topic
    mode: Mode  # meaning of the values
    values: Mapping[int, float]  # axis index to set-point: [rad], [rad/s] or [N m], by `mode`


@dataclass(frozen=True)
class JointSetPoint:
    """Set-point of one joint in a JointState; None: not given."""

    position: float | None = None  # [rad]
    velocity: float | None = None  # [rad/s]
    effort: float | None = None  # [N m]

    @property
    def streamed(self) -> bool:
        """True for a position with velocity or effort: a point of a streamed path."""
        return self.position is not None and (self.velocity is not None or self.effort is not None)


_FIELDS = {"position": Mode.POSITION, "velocity": Mode.SPEED, "effort": Mode.TORQUE}


def from_joint_command(
    source: str,
    joints: Sequence[str],
    names: Sequence[str],
    arrays: Mapping[str, Sequence[float]],
    interfaces: Mapping[str, Collection[str]] | None = None,
) -> dict[int, JointSetPoint]:
    """Return the set-points of a JointState, by axis.

    Parameters
    ----------
    source : str
        Topic, for messages.
    joints : sequence of str
        Joint names in the order of the axes.
    names : sequence of str
        Names in the message.
    arrays : mapping of str to sequence of float
        Position [rad], velocity [rad/s] and effort [N m] of the message; empty: not given; NaN: no value for a joint.
    interfaces : mapping of str to collection of str, optional
        Arrays that contain each joint; None: all arrays contain all joints.

    Returns
    -------
    dict of int to JointSetPoint
        Without joints that have no value.

    Raises
    ------
    Rejected
        If a name is unknown or given twice, all arrays are empty, a length is wrong, a number is infinite, or a joint
        has velocity and effort but no position.
    """
    listing = ", ".join(joints)
    if not names:
        raise Rejected(f"{source}: name is empty; write the names of the joints to move ({listing})")
    for name in names:
        if name not in joints:
            raise Rejected(f"{source}: joint {name!r} does not exist; the joints are {listing}")
    if len(set(names)) != len(names):
        raise Rejected(f"{source}: a joint occurs twice in {', '.join(names)}; write each joint once")
    if not any(len(values) for values in arrays.values()):
        raise Rejected(f"{source}: position, velocity and effort are empty; fill position, velocity or effort")
    given: dict[str, dict[str, float]] = {name: {} for name in names}
    for field, values in arrays.items():
        owners = names if interfaces is None else [name for name in names if field in interfaces[name]]
        if len(values) not in (0, len(owners)):
            raise Rejected(
                f"{source}: {field} has {len(values)} values for {len(owners)} names; write one value per name, NaN "
                "for joints without a set-point"
            )
        for name, value in zip(owners, values, strict=False):
            if math.isinf(value):
                raise Rejected(f"{source}: {field} of {name} is {value}; send a finite number")
            if not math.isnan(value):
                given[name][field] = float(value)
    result = {joints.index(name): JointSetPoint(**fields) for name, fields in given.items() if fields}
    for axis, point in result.items():
        if point.position is None and point.velocity is not None and point.effort is not None:
            raise Rejected(
                f"{source}: {joints[axis]} has a velocity and an effort, but no position; send one of them, or a "
                "position with them"
            )
    return result


def requests_of(source: str, points: Mapping[int, JointSetPoint]) -> list[SetPointRequest]:
    """Requests of the joints without streaming, one per mode."""
    result = []
    single = {axis: point for axis, point in points.items() if not point.streamed}
    for field, mode in _FIELDS.items():
        values = {axis: value for axis, point in single.items() if (value := getattr(point, field)) is not None}
        if values:
            result.append(SetPointRequest(source, mode, values))
    return result


def from_array(source: str, joints: Sequence[str], data: Sequence[float]) -> SetPointRequest:
    """Positions of all joints, in joint order [rad].

    Raises
    ------
    Rejected
        If the length is not the number of joints or a number is not finite.
    """
    if len(data) != len(joints):
        order = ", ".join(joints)
        raise Rejected(
            f"{source}: {len(data)} values given, {len(joints)} expected; write one position per joint ({order})"
        )
    for name, value in zip(joints, data, strict=True):
        _check_finite(source, f"position of {name}", value)
    return SetPointRequest(source, Mode.POSITION, {axis: float(value) for axis, value in enumerate(data)})


def from_single(source: str, axis: int, value: float) -> SetPointRequest:
    """Position of one joint [rad].

    Raises
    ------
    Rejected
        If the number is not finite.
    """
    _check_finite(source, "position", value)
    return SetPointRequest(source, Mode.POSITION, {axis: float(value)})


def _check_finite(source: str, name: str, value: float) -> None:
    if not math.isfinite(value):
        raise Rejected(f"{source}: {name} is {value}; send a finite number")
