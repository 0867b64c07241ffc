"""How the controllers come to know the speed: linear models of the M/T method and of the speed observer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from servo_msgs_py.tuning.linear import Matrix, Omega, held

FORGET: Final = 0.128
"""Time constant with which the phase-locked loop learns what the size of the back-EMF is off by [s]."""


class SpeedSensor(Protocol):
    """One speed measurement per slow tick."""

    @property
    def states(self) -> int:
        """Numbers that are remembered from tick to tick."""

    def step(self, x: Matrix, moved: Matrix, reference: Matrix, tick: float) -> tuple[Matrix, Sequence[Matrix]]:
        """One slow tick.

        Parameters
        ----------
        x : ndarray, shape (states, ...)
            What is remembered.
        moved : ndarray
            Movement of the shaft in the slow period that has just ended [rad].
        reference : ndarray
            Current set-point of that period [A].
        tick : float
            Its length [s].

        Returns
        -------
        speed : ndarray
            What the controllers get [rad/s].
        x : sequence of ndarray
            State to keep.
        """


@dataclass(frozen=True)
class MtSpeed:
    """M/T at a speed at which edges are frequent (DRM 2.4.4, F17).

    The first edge after each tick is timed and read at the next one: the mean speed of the period before the last.
    """

    states: int = 1

    def step(self, x: Matrix, moved: Matrix, reference: Matrix, tick: float) -> tuple[Matrix, Sequence[Matrix]]:
        """One slow tick; see `SpeedSensor.step`."""
        return x[0] / tick, (moved,)


@dataclass(frozen=True)
class Observer:
    """The speed observer, as far as it is linear: where an error is larger than a count.

    Smaller ones it leaves alone; then the speed is what the current has driven.
    """

    torque: float  # nominal acceleration per current [rad/s^2/A]
    l_position: float  # correction of the position per error and slow period
    l_speed: float  # correction of the speed per error and slow period
    l_acceleration: float  # correction of the acceleration per error and slow period
    states: int = 3

    def step(self, x: Matrix, moved: Matrix, reference: Matrix, tick: float) -> tuple[Matrix, Sequence[Matrix]]:
        """One slow tick; see `SpeedSensor.step`."""
        ahead, speed, unexplained = x  # estimate less shaft, speed, acceleration
        acceleration = self.torque * reference + unexplained
        ahead = ahead + tick * (speed + 0.5 * tick * acceleration) - moved
        speed = speed + tick * acceleration
        corrected = (
            ahead - self.l_position * ahead,
            speed - self.l_speed * ahead / tick,
            unexplained - self.l_acceleration * ahead / tick**2,
        )
        return corrected[1], corrected


@dataclass(frozen=True)
class PllSpeed:
    """The phase-locked loop on the observed back-EMF, as long as it is locked: its integral part.

    It knows the torque of the current, and learns from the angle and from the size of the back-EMF what torque it does
    not know. Where size and angle disagree for long, the angle is right.

    The observer before it and the period of the fast loop are short against it.
    """

    omega_n: float  # natural frequency at the speed of the shaft [rad/s]
    damping: float  # damping ratio at the speed of the shaft
    acceleration: float  # expected per q current [rad/s^2/A]
    load: float  # learned per angle and time, over omega_n^3
    follow: float  # increase of the speed per slow tick, per excess of the speed by the back-EMF's magnitude
    follow_load: float  # increase of the load, likewise
    states: int = 5

    def step(self, x: Matrix, moved: Matrix, reference: Matrix, tick: float) -> tuple[Matrix, Sequence[Matrix]]:
        """One slow tick; see `SpeedSensor.step`."""
        behind, speed, unknown, bias, size = (
            x  # angle of the shaft less its own, speed, acceleration; back-EMF as speed
        )
        kp, ki = 2.0 * self.damping * self.omega_n, self.omega_n**2
        f, g = held(np.array([[-kp, -1.0], [ki, 0.0]]), np.array([[1.0], [0.0]]), tick)
        more = size - bias - speed
        unknown = unknown + self.load * self.omega_n**3 * tick * behind + self.follow_load / tick * more
        told = speed + tick * (self.acceleration * reference + unknown) + self.follow * more
        after, speed = f @ np.vstack([behind, told]) + g @ (moved[None, :] / tick)
        size = moved / tick
        bias = bias + tick / FORGET * (speed - (size - (after - behind) / tick))
        return speed, (after, speed, unknown, bias, size)


@dataclass(frozen=True)
class EdgeDelay:
    """What M/T does to a slow signal."""

    window: float  # length of the mean [s]
    delay: float  # from the middle of the window to its use [s]

    def response(self, omega: Omega) -> NDArray[np.complex128]:
        """Frequency response at `omega` [rad/s], of the same shape."""
        return np.asarray(np.sinc(omega * self.window / (2.0 * np.pi)) * np.exp(-1j * omega * self.delay))


def edge_delay(lines: float, tick: float, speed: float) -> EdgeDelay:
    """M/T at some speed [rad/s], in the mean over all places of the edges between the ticks.

    There are two B edges per line. While several come per slow period the first one after a tick is timed, half an
    interval after it. When they are rarer than ticks every one is timed, and it waits for half an interval.
    """
    interval = 2.0 * math.pi / (2.0 * lines * speed)
    if interval < tick:
        return EdgeDelay(tick, 1.5 * tick - 0.5 * interval)
    return EdgeDelay(interval, interval)
