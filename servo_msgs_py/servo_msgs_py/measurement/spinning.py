"""Flux, friction, load and inertia from an axis that runs at several speeds and reverses. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from servo_msgs_py.measurement.access import Recording
from servo_msgs_py.measurement.least_squares import Floats, fit_linear, mean_of
from servo_msgs_py.measurement.motor_values import Estimate
from servo_msgs_py.units import COUNTS_PER_TURN

__all__ = ["Steady", "balance", "flux", "friction", "steady_of", "torque_of"]

RADIANS: Final = 2.0 * math.pi / COUNTS_PER_TURN


@dataclass(frozen=True)
class Steady:
    """Means over a time at constant speed, each with its standard uncertainty.

    Attributes
    ----------
    speed : float
        Of the shaft, from its way [rad/s].
    i_d, i_q, u_q : Estimate
        [A], [A], [V].
    """

    speed: float
    i_d: Estimate
    i_q: Estimate
    u_q: Estimate


def steady_of(recording: Recording, axis: str, seconds: float) -> Steady:
    """Of the last part of a recording."""
    count = max(round(seconds / recording.step), 16)
    part = {name: recording.columns[f"{axis}.{name}"][-count:] for name in ("position", "i_d", "i_q", "u_q")}
    usable = np.isfinite(part["position"])
    time = recording.step * np.arange(count)[usable]
    slope = float(np.polyfit(time, part["position"][usable] * RADIANS, 1)[0])
    means = {name: Estimate(*mean_of(part[name])) for name in ("i_d", "i_q", "u_q")}
    return Steady(slope, **means)


def torque_of(i_d: Floats, i_q: Floats, pairs: int, psi: float, l_d: float, l_q: float) -> Floats:
    """Air-gap torque [N m]."""
    return 1.5 * pairs * (psi + (l_d - l_q) * i_d) * i_q


def flux(points: list[Steady], pairs: int, r: Estimate, l_d: float) -> Estimate:
    """Flux linkage from the voltage over the speed; what dead time and drops take has the sign of the current [V s]."""
    speed = np.array([point.speed for point in points]) * pairs
    i_d, i_q = (np.array([getattr(point, name).value for point in points]) for name in ("i_d", "i_q"))
    u_q = np.array([point.u_q.value for point in points])
    sigma = np.array([max(point.u_q.sigma, 1e-3) for point in points])
    columns = np.column_stack([speed, np.sign(speed), np.ones_like(speed)])
    (psi, _, _), covariance, _ = fit_linear(columns, u_q - r.value * i_q - speed * l_d * i_d, sigma)
    # an error of the resistance counts as far as the current grows with the speed
    (grown, _, _), _, _ = fit_linear(columns, i_q)
    return Estimate(float(psi), math.hypot(float(np.sqrt(covariance[0, 0])), abs(float(grown)) * r.sigma))


def friction(points: list[Steady], torque: Floats, torque_sigma: Floats) -> dict[str, Estimate]:
    """Coulomb and viscous friction and load from the torques at constant speeds."""
    speed = np.array([point.speed for point in points])
    columns = np.column_stack([np.sign(speed), speed, np.ones_like(speed)])
    x, covariance, _ = fit_linear(columns, torque, np.maximum(torque_sigma, 1e-9))
    errors = np.sqrt(np.diag(covariance))
    return {name: Estimate(float(x[k]), float(errors[k])) for k, name in enumerate(("friction", "viscous", "load"))}


def balance(
    recordings: list[Recording], axis: str, motor: tuple[int, float, float, float], parts: tuple[float, float, float] | None
) -> tuple[Estimate, Estimate]:
    """Inertia and Coulomb friction from momentum: what the torque has given until a moment is in the shaft's speed.

    Parameters
    ----------
    recordings : list of Recording
        Of an axis that speeds up and slows down.
    axis : str
        Its name.
    motor : tuple
        Pole pairs, ``psi_m``, ``l_d``, ``l_q``.
    parts : tuple of float, optional
        Coulomb, viscous friction and load; without them the Coulomb friction is estimated, too.
    """
    rows: list[Floats] = []
    values: list[Floats] = []
    for k, recording in enumerate(recordings):
        position = recording.columns[f"{axis}.position"] * RADIANS
        torque = torque_of(recording.columns[f"{axis}.i_d"], recording.columns[f"{axis}.i_q"], *motor)
        speed = np.diff(position) / recording.step
        middle = torque[1:-1]  # between the middles of two intervals
        change = np.diff(speed)
        at = 0.5 * (speed[1:] + speed[:-1])
        usable = np.isfinite(change) & np.isfinite(middle)
        given = np.where(usable, middle, 0.0) * recording.step
        sign = np.where(usable, np.tanh(at / 1.0), 0.0) * recording.step
        if parts is not None:
            coulomb, viscous, load = parts
            given = given - coulomb * sign - np.where(usable, viscous * at + load, 0.0) * recording.step
        total = np.cumsum(given)[usable]
        gained = np.cumsum(np.where(usable, change, 0.0))[usable]
        own = np.zeros((total.size, len(recordings)))
        own[:, k] = 1.0
        columns = [gained, own] if parts is not None else [gained, np.cumsum(sign)[usable], own]
        rows.append(np.column_stack(columns))
        values.append(total)
    x, covariance, _ = fit_linear(np.vstack(rows), np.concatenate(values))
    errors = np.sqrt(np.diag(covariance)) * 5.0  # the sums are not independent of each other
    coulomb = Estimate(float(x[1]), float(errors[1])) if parts is None else Estimate(parts[0], 0.0)
    return Estimate(float(x[0]), float(errors[0])), coulomb
