"""Harmonics of the torque ripple, from turns of the shaft in both directions.

The shaft follows J d(omega^2/2)/dtheta = K_t i_q + T(theta) - friction. With z_n = integral of z exp(-j n theta) dtheta
over one turn, and the change D of omega^2/2 from its start theta_0 to its end,

    T_n = J (D exp(-j n theta_0) + j n (omega^2/2)_n) - K_t (i_q)_n

so that no sample is differentiated. Friction is constant in each direction and has no harmonic.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_tuning.sensors import EdgeDelay
from servo_tuning.torque_ripple import HARMONICS_MAX, Harmonic

from servo_measurement.least_squares import Floats

Complexes = NDArray[np.complex128]

ORDER_MAX: Final = 100
ORDERS: Final = np.arange(1, ORDER_MAX + 1)
TURN: Final = 2.0 * math.pi
FALSE_ALARM: Final = 0.01
"""Probability that a shaft without torque ripple has a significant harmonic."""

_RESOLUTION: Final = 1e-9  # least standard error [N m]


@dataclass(frozen=True)
class Measured:
    """A harmonic and its uncertainties for 95 %."""

    harmonic: Harmonic
    amplitude: float  # [N m]
    phase: float  # [rad]


def turn_ripple(
    time: Floats, angle: Floats, speed: Floats, torque: Floats, inertia: float, sensor: EdgeDelay
) -> Complexes:
    """Torque ripple of the first whole turn of a recording.

    Parameters
    ----------
    time : ndarray, shape (n,)
        [s].
    angle : ndarray, shape (n,)
        Position of the shaft [rad].
    speed : ndarray, shape (n,)
        Speed as measured by the sensor [rad/s].
    torque : ndarray, shape (n,)
        Torque of the current, K_t i_q [N m].
    inertia : float
        [kg m^2].
    sensor : EdgeDelay
        Delay of the speed, and the window of its mean.

    Returns
    -------
    ndarray, shape (ORDER_MAX,)
        amplitude exp(j phase) of each order [N m].

    Raises
    ------
    ValueError
        If the shaft has not made a whole turn.
    """
    known = time >= time[0] + sensor.delay
    energy_angle = np.interp(time[known] - sensor.delay, time, angle)
    energy_angle, energy = _whole_turn(energy_angle, 0.5 * speed[known] ** 2)
    angle, torque = _whole_turn(angle, torque)
    change = (energy[-1] - energy[0]) * np.exp(-1j * ORDERS * energy_angle[0])
    frequency = ORDERS * abs(float(np.mean(speed)))  # [rad/s]
    window = np.sinc(frequency * sensor.window / TURN)
    motion = math.copysign(1.0, angle[-1] - angle[0]) * change + 1j * ORDERS * _projected(energy_angle, energy) / window
    result: Complexes = 1j / math.pi * (inertia * motion - _projected(angle, torque))
    return result


def _whole_turn(angle: Floats, values: Floats) -> tuple[Floats, Floats]:
    """The first turn; its last sample is interpolated at the exact end."""
    gone = np.abs(angle - angle[0])
    end = int(np.argmax(gone >= TURN))
    if gone[end] < TURN:
        raise ValueError(f"a recording contains {float(gone.max() / TURN):.2f} of a turn")
    part = (TURN - gone[end - 1]) / (gone[end] - gone[end - 1])
    last = values[end - 1] + part * (values[end] - values[end - 1])
    at = angle[0] + math.copysign(TURN, angle[end] - angle[0])
    return np.append(angle[:end], at), np.append(values[:end], last)


def _projected(angle: Floats, values: Floats) -> Complexes:
    """Integral of (values - mean) exp(-j n angle) d|angle| for all orders."""
    step = np.diff(angle)
    weight = 0.5 * (np.append(step, 0.0) + np.append(0.0, step)) * math.copysign(1.0, angle[-1] - angle[0])
    centred = values - float(weight @ values) / TURN
    result: Complexes = np.exp(-1j * np.outer(ORDERS, angle)) @ (weight * centred)
    return result


def significant(forward: Sequence[Complexes], backward: Sequence[Complexes]) -> list[Measured]:
    """The greatest significant harmonics, by order.

    The standard error of the mean of both directions is that of the scatter of the turns or that of the difference of
    the directions, whichever is greater. A harmonic is significant if noise with this error reaches its amplitude in
    any of the orders with a probability below `FALSE_ALARM` (F test); with eight turns in each direction this is 5.1
    standard errors.

    Parameters
    ----------
    forward, backward : sequence of ndarray
        Results of `turn_ripple`, at least two in each direction.
    """
    groups = [np.array(forward), np.array(backward)]
    first, second = (group.mean(axis=0) for group in groups)
    mean = 0.5 * (first + second)
    degrees = 2 * sum(len(group) - 1 for group in groups)
    scatter = sum((np.abs(group - group.mean(axis=0)) ** 2).sum(axis=0) for group in groups) / degrees
    variance = 0.25 * scatter * sum(1.0 / len(group) for group in groups)
    sigma = np.maximum(np.sqrt(np.maximum(variance, np.abs(first - second) ** 2 / 8.0)), _RESOLUTION)
    amplitude = np.abs(mean)
    chance = (1.0 + (amplitude / sigma) ** 2 / degrees) ** (-0.5 * degrees)
    (found,) = np.nonzero(chance < FALSE_ALARM / ORDER_MAX)
    greatest = sorted(found, key=lambda k: -amplitude[k])[:HARMONICS_MAX]
    error = (1.96 + 2.4 / degrees) * sigma  # quantile of the t distribution
    return [
        Measured(
            Harmonic(int(ORDERS[k]), float(amplitude[k]), float(np.angle(mean[k])) % TURN),
            float(error[k]),
            math.asin(min(float(error[k] / amplitude[k]), 1.0)),
        )
        for k in sorted(greatest)
    ]
