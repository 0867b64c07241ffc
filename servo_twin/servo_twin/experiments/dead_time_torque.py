"""Torque that the controller asks for and the inverter keeps back, and how far that moves a shaft.

Dead time and the drops of switches and diodes hold a phase at zero until the current controller has wound up against
them. On the averaged plant they fade away with the current; where every edge of the gates counts they stay, and around
zero they keep back as much current as friction needs (`KEPT_BACK`; the axes turn with 40 mA). What a feature of the
control does with its set-point of the current is one thing, what becomes of that current another; experiments that are
about the former take the latter out, or allow for it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servo_twin.experiments.rig import COUNT, TICK, Recording
from servo_twin.plant import AxisPlant

KEPT_BACK: Final = 0.06
"""Current around zero that dead time and drops keep back where every edge of the gates counts [A]."""

SPEED_LOOP: Final = 2.0 * math.pi * 75.0
"""Bandwidth of the speed controller [rad/s], which answers such a torque."""

INTEGRAL: Final = SPEED_LOOP / 5.0
"""Corner frequency of its integral part [rad/s]."""

POSITION_GAIN: Final = 60.0
"""Of the position controller [1/s]."""

ANSWERED: Final = 0.2
"""Twelve of its time constants: a constant torque has moved the shaft as far as it will [s]."""


def pushed(recording: Recording, axis: AxisPlant, *, position: bool, heavier: float = 1.0) -> NDArray[np.float64]:
    """How far the shaft is from where it would be if the current flowed that was asked for [counts].

    Parameters
    ----------
    recording : Recording
        Of the axis, with the plant's own current in it.
    axis : AxisPlant
        Its motor.
    position : bool
        Under position control; else under speed control.
    heavier : float
        Inertia over the one that the loops are tuned for: they are so much slower.
    """
    lacking = axis.torque_constant * (recording.i_q_true - recording.i_q_ref)
    return answer(lacking, axis, position=position, heavier=heavier)


def answer(
    torques: NDArray[np.float64], axis: AxisPlant, *, position: bool, heavier: float = 1.0
) -> NDArray[np.float64]:
    """How far torques move a shaft against the linear loops, with the bandwidths that servo.toml gives them [counts].

    Parameters
    ----------
    torques : ndarray
        One per slow tick [N m].
    axis, position, heavier
        As for `pushed`.
    """
    bandwidth = SPEED_LOOP / heavier
    gain = POSITION_GAIN if position else 0.0
    speed = way = integral = 0.0
    ways: list[float] = []
    for torque in torques:
        error = speed + gain * way
        integral += TICK * error
        speed += TICK * (float(torque) / axis.inertia - bandwidth * (error + INTEGRAL * integral))
        way += TICK * speed
        ways.append(way)
    return np.asarray(ways) / COUNT


def whole_counts(recording: Recording, axis: AxisPlant, after: float, heavier: float = 1.0) -> float:
    """The most that it moves a shaft under position control from `after` on [s], as a position shows it [counts]."""
    way = pushed(recording, axis, position=True, heavier=heavier)
    return float(round(np.abs(way[recording.time > after]).max(initial=0.0)))


def swerve_at(recording: Recording, axis: AxisPlant, target: float, within: float) -> float:
    """The same from when the set-point is within so many counts of a target [counts]."""
    near = np.abs(recording.position_ref - target) <= within
    return whole_counts(recording, axis, float(recording.time[int(np.argmax(near))])) if near.any() else 0.0


def swerve(axis: AxisPlant) -> int:
    """How far `KEPT_BACK` moves a shaft under position control before the loops have answered [counts]."""
    torques = np.full(round(ANSWERED / TICK), axis.torque_constant * KEPT_BACK)
    return round(float(np.abs(answer(torques, axis, position=True)).max()))
