"""Gains from motor data and bandwidths, in SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from servo_tuning.configuration import Axis, Board
from servo_tuning.motor import Motor

EXCHANGE_USE: Final = 0.5
"""Largest natural frequency of winding and shaft, over the bandwidth of the current loop. At 0.66 and above some random
motors lost their encoder, or friction held them with the speed loop that such a current loop permits."""
CURRENT_SAMPLES_MIN: Final = 9.0
"""Samples per period at the largest recommended bandwidth of the current loop; 8 give a phase margin of 45 degrees."""

INTEGRAL_CORNER_MIN: Final = 1.0 / 6.0
"""Smallest corner of the integral part of a current controller, over its bandwidth, if the phase margin permits it.
With a large L / R pole-zero cancellation makes the integral part slow. Near zero current dead time acts as a
resistance, in four random motors of 4 to 115 ohm: the current lagged its set-point by 30 ms and more, and light shafts
oscillated about their target by up to 16 counts. With a tenth one still did, by 7."""
CURRENT_PHASE_MIN: Final = math.radians(50.0)
"""Phase margin of a current loop below which the integral part is not made faster than by pole-zero cancellation."""

TRACKING: Final = 11.0
"""Largest Kc of a PI controller, over its Ki Ts; 1 is tracking in the integral time. A set-point that saturates it for
few samples, such as by an encoder count, must not move its integral part far. With Kc = 0.5 the current of
windings with L / R = 15 ms stayed away from its set-point, and heavy shafts oscillated."""


@dataclass(frozen=True)
class Pi:
    """A PI controller in discrete time: ``u_i += ki e + kc excess``, ``u = kp e + u_i`` (DRM E34..E37)."""

    kp: float  # proportional gain [output per input]
    ki: float  # Kp Ki Ts of E36 [output per input and sample]
    kc: float  # anti-windup, 0 .. 1


@dataclass(frozen=True)
class Gains:
    """Gains of one axis."""

    current_d: Pi  # ampere to volt, per fast loop
    current_q: Pi  # ampere to volt, per fast loop
    speed: Pi  # rad/s to ampere, per slow loop
    position: float  # K_v, rad to rad/s [1/s]
    path_omega_n: float  # of E40 [rad/s]

    def named(self) -> Iterator[tuple[str, str, float]]:
        """Name, unit and value of each gain."""
        for name, pi in (("current d", self.current_d), ("current q", self.current_q)):
            yield f"{name} Kp", "V/A", pi.kp
            yield f"{name} Kp Ki Ts", "V/A", pi.ki
        yield "speed Kp", "A s/rad", self.speed.kp
        yield "speed Kp Ki Ts", "A s/rad", self.speed.ki
        yield "anti-windup Kc", "", self.speed.kc
        yield "position K_v", "1/s", self.position
        yield "path omega_n", "rad/s", self.path_omega_n

    @classmethod
    def of(cls, axis: Axis, board: Board) -> Gains:
        acceleration = (
            axis.torque_constant * axis("limits.current") * axis("control.path_current_use") / axis("motor.inertia")
        )
        return cls(
            current_d=_current(axis, axis("motor.l_d"), board),
            current_q=_current(axis, axis("motor.l_q"), board),
            speed=speed_pi(axis, board, axis("control.speed_bandwidth")),
            position=axis("control.position_gain"),
            # E40: a speed step v needs an acceleration of at most v omega_n / e
            path_omega_n=math.e * acceleration / axis("limits.speed"),
        )


def _current(axis: Axis, inductance: float, board: Board) -> Pi:
    """Pole-zero cancellation, the open loop is omega / s; or a faster integral part."""
    omega = 2.0 * math.pi * axis("control.current_bandwidth")
    permitted = math.pi / 2.0 - omega * board.period - CURRENT_PHASE_MIN  # the loop has a delay of one period
    corner = omega * min(INTEGRAL_CORNER_MIN, max(math.tan(permitted), 0.0))
    kp, ki = omega * inductance, omega * max(axis("motor.r_s"), corner * inductance) * board.period
    return Pi(kp, ki, _anti_windup(axis, ki / kp))


def current_bandwidth_min(motor: Motor, pwm_frequency: float) -> float:
    """Bandwidth of the current loop that damps the exchange of energy between winding and shaft, in whole Hz [Hz]."""
    return math.ceil(min(motor.exchange / EXCHANGE_USE, pwm_frequency / CURRENT_SAMPLES_MIN))


def speed_pi(axis: Axis, board: Board, bandwidth: float) -> Pi:
    """Gains for a crossover at the bandwidth [Hz]; the integral part acts below bandwidth / speed_ratio."""
    omega = 2.0 * math.pi * bandwidth
    kp = omega * axis("motor.inertia") / axis.torque_constant
    ki = kp * omega / axis("control.speed_ratio") * board.tick
    return Pi(kp, ki, _anti_windup(axis, ki / kp))


def _anti_windup(axis: Axis, k_i_ts: float) -> float:
    return min(axis("control.anti_windup"), TRACKING * k_i_ts)
