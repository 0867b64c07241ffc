"""Sensorless operation in SI units: Luenberger observer of the back-EMF, phase-locked loop (PLL), start-up.

The observer is the one of the ST document in the frame of DRM E11..E15, with L = (L_d + L_q) / 2; vectors are complex:

    L di/dt = v - R i - e,  de/dt = j omega e,  e = j omega psi_m exp(j theta)

With the period T, a = exp(-R T / L), b = (1 - a) / R: the estimates of current and back-EMF are corrected by K1 and K2
times ``error = i_estimated - i`` and extrapolated, ``i = a i + b (v - e)``, ``e = e exp(j omega T)``. K1 and K2 per
second are those of the differential equations of the ST document.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servo_tuning.configuration import Axis, Board
from servo_tuning.gains import Pi, speed_pi

ST_I_PER_SPEED: Final = 60.0 / 2.0**19
"""omega_n^2 / omega_e per unit of the number in the rule of the ST document (slide "Calculation of the closed-loop
coefficients of the PLL").

The library computes ``P err / 2^14 + sum(I err) / 2^18``, 2^16 a turn, per period; err = 2^15 sin(delta) if the
back-EMF has the amplitude at f_max, and I = 1506742 f_max / f_s^2 with f_max in electrical turns per minute. f_max and
f_s cancel: omega_n^2 = 172.4 omega_e for any motor.
"""

ST_P: Final = 532.0 * 60.0 / 2.0**15
"""Proportional gain of the rule of the ST document over omega_e, derived in the same manner: 0.974."""


def inductance(axis: Axis) -> float:
    """Inductance used by the observer, the mean of both axes [H]."""
    return 0.5 * (axis("motor.l_d") + axis("motor.l_q"))


def st_damping(omega_e: float) -> float:
    """Damping of the PLL with both gains of the ST document, at an electrical speed [rad/s]."""
    return 0.5 * ST_P * math.sqrt(omega_e / (1506742.0 * ST_I_PER_SPEED))


@dataclass(frozen=True)
class BackEmfObserver:
    """Observer of the back-EMF, with its gains."""

    r_s: float  # of the nominal winding [ohm]
    inductance: float  # of the nominal winding [H]
    k1: float  # correction of the current per error and period
    k2: float  # correction of the back-EMF per error and period [V/A]
    period: float  # of the samples [s]

    @property
    def a(self) -> float:
        """Decay of the current in one period, exp(-R T / L)."""
        return math.exp(-self.r_s * self.period / self.inductance)

    @property
    def b(self) -> float:
        """Current per voltage after one period [A/V]."""
        return -math.expm1(-self.r_s * self.period / self.inductance) / self.r_s

    def matrix(self, omega_e: float) -> NDArray[np.complex128]:
        """Transition matrix of the errors of current and back-EMF over one period, at an electrical speed [rad/s]."""
        turn = cmath.exp(1j * omega_e * self.period)
        a, b, kept = self.a, self.b, 1.0 + self.k1
        return np.array([[a * kept, -b * kept], [turn * self.k2 * a, turn * (1.0 - b * self.k2)]])

    def poles(self, omega_e: float) -> tuple[complex, complex]:
        """Poles of the observer error at the electrical speed `omega_e` [rad/s], the slower first."""
        slow, fast = sorted((complex(z) for z in np.linalg.eigvals(self.matrix(omega_e))), key=abs, reverse=True)
        return slow, fast

    def radius(self, omega_e: float) -> float:
        """Magnitude of the slower pole at the electrical speed `omega_e` [rad/s]."""
        return abs(self.poles(omega_e)[0])

    def winding(self, r_s: float = 1.0, inductance: float = 1.0) -> BackEmfObserver:
        """Observer with the same gains and another winding; resistance and inductance as ratios."""
        return BackEmfObserver(self.r_s * r_s, self.inductance * inductance, self.k1, self.k2, self.period)

    @classmethod
    def of(cls, axis: Axis, board: Board) -> BackEmfObserver:
        """Observer with given K1 and K2, or with a bandwidth above half the decay rate of the winding.

        With damping 1 both poles are ``s = -R / 2L - 2 pi f``, so that ``p1 p2 = a (1 + K1)`` keeps K1 below 0 for any
        winding; ``(1 - p1) (1 - p2) = b K2``.
        """
        r_s, l_s, period = axis("motor.r_s"), inductance(axis), board.period
        if axis.given("observer.k_1"):
            return cls(r_s, l_s, axis("observer.k_1") * period, axis("observer.k_2") * period, period)
        omega = 2.0 * math.pi * axis("observer.bandwidth")
        k1 = math.expm1(-2.0 * axis("observer.damping") * omega * period)
        bare = cls(r_s, l_s, k1, 0.0, period)
        product = bare.a * (1.0 + k1)
        half = math.sqrt(product) * _cosh(omega * period, axis("observer.damping"))
        return cls(r_s, l_s, k1, (1.0 + product - 2.0 * half) / bare.b, period)


def _cosh(step: float, damping: float) -> float:
    """Mean of two poles over the square root of their product."""
    return cmath.cosh(step * cmath.sqrt(damping**2 - 1.0)).real


@dataclass(frozen=True)
class Pll:
    """PLL on the back-EMF: ``omega += omega_n^2 delta``, ``theta += omega + 2 zeta omega_n delta``."""

    rate: float  # omega_n^2 over the electrical speed [1/s]
    damping: float  # at every speed
    acceleration: float  # mechanical, expected per q current [rad/s^2/A]
    load: float  # gain of the load acceleration estimate, over omega_n^3
    size: float  # bandwidth with which the speed follows the amplitude of the back-EMF [rad/s]

    def omega_n(self, omega_e: float) -> float:
        """Natural frequency at an electrical speed [rad/s]."""
        return math.sqrt(self.rate * abs(omega_e))

    @classmethod
    def of(cls, axis: Axis) -> Pll:
        rate = axis("observer.pll_i") * ST_I_PER_SPEED
        per_current = axis("observer.pll_torque") * axis.torque_constant / axis("motor.inertia")
        return cls(
            rate=rate,
            damping=axis("observer.pll_damping"),
            acceleration=per_current,
            load=axis("observer.pll_load"),
            size=2.0 * math.pi * axis("observer.pll_size"),
        )

    def size_gains(self, tick: float) -> tuple[float, float]:
        """Gains per `tick` [s] from the amplitude of the back-EMF to speed and load; both poles at the bandwidth."""
        kept = math.exp(-self.size * tick)
        return 1.0 - kept**2, (1.0 - kept) ** 2


@dataclass(frozen=True)
class StartUp:
    """Ramps of the rotating current vector."""

    current_first: float  # length of the vector before its ramp [A]
    current_final: float  # length of the vector after its ramp [A]
    current_time: float  # duration of that ramp [s]
    speed_final: float  # mechanical, at the end of the speed ramp [rad/s]
    speed_time: float  # duration of that ramp [s]
    time_max: float  # after which the start-up has failed [s]
    minimum_speed: float  # smallest mean of the observed speed for success [rad/s]
    swing: float  # angular frequency of the rotor's oscillation about the final vector [rad/s]
    damping: float  # current across the vector per back-EMF across it [A/V]
    torque: float  # largest torque for friction and acceleration, fraction of the torque of the vector

    @property
    def acceleration(self) -> float:
        """Mechanical acceleration of the ramp [rad/s^2]."""
        return self.speed_final / self.speed_time

    @classmethod
    def of(cls, axis: Axis) -> StartUp:
        p, inertia, k_t = axis("motor.pole_pairs"), axis("motor.inertia"), axis.torque_constant
        first, final = (axis("limits.current") * axis(f"start_up.current_{key}") for key in ("first", "final"))
        oscillation = math.sqrt(p * k_t * final / inertia)
        period = 2.0 * math.pi / oscillation
        ramp = axis("start_up.speed_time") if axis.given("start_up.speed_time") else axis("start_up.swings") * period
        speed, current_time = axis("limits.speed") * axis("start_up.speed_final"), axis("start_up.current_time")

        def needed(time: float) -> float:
            turning = speed * min(time / ramp, 1.0)
            load = inertia * speed / ramp + axis("friction.coulomb") + axis("friction.viscous") * turning
            return load / (k_t * (first + (final - first) * min(time / current_time, 1.0)))

        return cls(
            current_first=first,
            current_final=final,
            current_time=current_time,
            speed_final=speed,
            speed_time=ramp,
            time_max=ramp + axis("start_up.wait_max"),
            minimum_speed=axis("limits.speed") * axis("start_up.minimum_speed"),
            swing=oscillation,
            damping=2.0 * axis("start_up.swing_damping") * oscillation * inertia / (p * k_t * axis("motor.psi_m")),
            torque=max(needed(time) for time in (0.0, min(current_time, ramp), ramp)),
        )


@dataclass(frozen=True)
class Sensorless:
    """Observer, PLL, start-up and speed controller of one axis."""

    observer: BackEmfObserver  # with its gains
    pll: Pll  # phase-locked loop
    start_up: StartUp  # open-loop start
    speed: Pi  # speed controller of the sensorless axis, rad/s to ampere, per slow loop

    @classmethod
    def of(cls, axis: Axis, board: Board) -> Sensorless:
        bandwidth = axis("observer.speed_part") * axis("control.speed_bandwidth")
        speed = speed_pi(axis, board, bandwidth)
        return cls(BackEmfObserver.of(axis, board), Pll.of(axis), StartUp.of(axis), speed)


def angle_error(axis: Axis, omega_e: float, i_q: float, r_s: float = 1.0, inductance_: float = 1.0) -> float:
    """Steady-state error of the observed angle with a winding that differs from the nominal one, at i_d = 0 [rad].

    For any K1 and K2 the observer estimates ``e + (R - R^) i + j omega (L_q - L^) i``: an error of R changes the
    amplitude, only an error of L changes the angle.

    Parameters
    ----------
    axis : Axis
        Nominal values.
    omega_e : float
        Electrical speed [rad/s].
    i_q : float
        Current [A].
    r_s, inductance_ : float
        True values over nominal ones.
    """
    more_l = inductance_ * axis("motor.l_q") - inductance(axis)
    more_r = (r_s - 1.0) * axis("motor.r_s")
    psi = axis("motor.psi_m")
    return math.atan2(more_l * i_q, psi + more_r * i_q / omega_e)
