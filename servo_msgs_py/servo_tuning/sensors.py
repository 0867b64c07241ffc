"""Linear models of the speed measurement: M/T method, speed observer, PLL on the back-EMF."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from servo_tuning.linear import Matrix, Omega, held

AMPLITUDE_OFFSET_TIME: Final = 0.128
"""Time constant of the estimate of the amplitude offset of the back-EMF in the PLL [s]."""


class SpeedSensor(Protocol):
    """Speed measurement of one slow tick."""

    @property
    def states(self) -> int:
        """Number of states."""

    def step(self, x: Matrix, moved: Matrix, reference: Matrix, tick: float) -> tuple[Matrix, Sequence[Matrix]]:
        """One slow tick.

        Parameters
        ----------
        x : ndarray, shape (states, ...)
            States.
        moved : ndarray
            Movement of the shaft in the last slow period [rad].
        reference : ndarray
            Current set-point of that period [A].
        tick : float
            Length of the period [s].

        Returns
        -------
        speed : ndarray
            Measured speed [rad/s].
        x : sequence of ndarray
            New states.
        """


@dataclass(frozen=True)
class MtSpeed:
    """M/T method at speeds with frequent edges (DRM 2.4.4, F17).

    The first edge after each tick is timed and read at the next tick: the mean speed of the period before the last.
    """

    states: int = 1

    def step(self, x: Matrix, moved: Matrix, reference: Matrix, tick: float) -> tuple[Matrix, Sequence[Matrix]]:
        """One slow tick; see `SpeedSensor.step`."""
        return x[0] / tick, (moved,)


@dataclass(frozen=True)
class Observer:
    """Speed observer in its linear range: errors of more than one count.

    It does not correct smaller errors; the speed then follows the current.
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
    """Locked PLL on the observed back-EMF: its integral part.

    Acceleration by i_q is fed forward; the load is estimated from the angle and from the amplitude of the back-EMF. An
    offset of the amplitude is estimated from the angle.

    The delays of the observer and of the fast loop are neglected.
    """

    omega_n: float  # natural frequency at the speed of the shaft [rad/s]
    damping: float  # damping ratio at the speed of the shaft
    acceleration: float  # expected per q current [rad/s^2/A]
    load: float  # gain of the load acceleration estimate, over omega_n^3
    amplitude_gain: float  # correction of the speed per slow tick / speed error of the back-EMF amplitude
    amplitude_load_gain: float  # correction of the load acceleration per slow tick, times the tick / that error
    states: int = 5

    def step(self, x: Matrix, moved: Matrix, reference: Matrix, tick: float) -> tuple[Matrix, Sequence[Matrix]]:
        """One slow tick; see `SpeedSensor.step`."""
        behind, speed, unknown, bias, size = (
            x  # angle error, speed, load acceleration; offset and amplitude of the back-EMF as speeds
        )
        kp, ki = 2.0 * self.damping * self.omega_n, self.omega_n**2
        f, g = held(np.array([[-kp, -1.0], [ki, 0.0]]), np.array([[1.0], [0.0]]), tick)
        more = size - bias - speed
        unknown = unknown + self.load * self.omega_n**3 * tick * behind + self.amplitude_load_gain / tick * more
        predicted = speed + tick * (self.acceleration * reference + unknown) + self.amplitude_gain * more
        after, speed = f @ np.vstack([behind, predicted]) + g @ (moved[None, :] / tick)
        size = moved / tick
        bias = bias + tick / AMPLITUDE_OFFSET_TIME * (speed - (size - (after - behind) / tick))
        return speed, (after, speed, unknown, bias, size)


@dataclass(frozen=True)
class EdgeDelay:
    """Transfer function of the M/T method for small signals."""

    window: float  # length of the mean [s]
    delay: float  # from the middle of the window to the use of the mean [s]

    def response(self, omega: Omega) -> NDArray[np.complex128]:
        """Frequency response at `omega` [rad/s], of the same shape."""
        return np.asarray(np.sinc(omega * self.window / (2.0 * np.pi)) * np.exp(-1j * omega * self.delay))


def edge_delay(lines: float, tick: float, speed: float) -> EdgeDelay:
    """M/T method at a speed [rad/s], averaged over the phase of the edges relative to the ticks.

    There are two B edges per line. With several edges per slow period the first one after a tick is timed, on average
    half an interval after the tick. With rarer edges each one is timed, and is on average half an interval old.
    """
    interval = 2.0 * math.pi / (2.0 * lines * speed)
    if interval < tick:
        return EdgeDelay(tick, 1.5 * tick - 0.5 * interval)
    return EdgeDelay(interval, interval)
