"""Test rig: observer and PLL of the firmware on a motor model in floating point [V, A, rad]."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any, Final

from core_library import Core

U_FS, I_FS = 24.2, 8.25
FULL_SPEED: Final = 523.5987755982989  # rad/s mechanical
T: Final = 62.5e-6
SLOW: Final = 8
PAIRS: Final = 2
R, L, PSI = 0.55, 0.4575e-3, 0.0154
"""Motor data of axis 1 in servo.toml; the observer uses the mean of both inductances."""


def frac16(x: float) -> int:
    """Fraction of 15 bits, saturated."""
    return min(max(round(x * 32768), -32768), 32767)


def ab(x: complex, full_scale: float) -> dict[str, int]:
    """A vector in the format of the firmware."""
    return {"alpha": frac16(x.real / full_scale), "beta": frac16(x.imag / full_scale)}


def wrapped(angle: float) -> float:
    """Angle within -pi .. pi."""
    return math.remainder(angle, 2.0 * math.pi)


class Estimator:
    """Observer and PLL of axis 1, called in the order of the firmware."""

    def __init__(self, core: Core) -> None:
        self.lib, self.ffi = core.lib, core.ffi
        self.config: Any = core.lib.probe_config().axis[0]
        self._pll: Any = core.ffi.new("pll_config_t *", self.config.pll)
        self.observer: Any = core.ffi.new("back_emf_observer_t *")
        self.pll: Any = core.ffi.new("pll_t *")
        self.lib.back_emf_observer_reset(self.observer, self._observer, {"alpha": 0, "beta": 0})
        self.start(0.0, 0.0)

    @property
    def _observer(self) -> Any:
        return self.ffi.addressof(self.config, "observer")

    def ignore_amplitude(self) -> None:
        """Disable the speed correction by the amplitude of the back-EMF."""
        self._pll.amplitude_gain = self._pll.amplitude_load_gain = 0

    def start(self, theta: float, omega: float) -> None:
        """Set the PLL to an electrical angle and speed [rad, rad/s]."""
        angle = round(theta / (2.0 * math.pi) * 2**32) & 0xFFFFFFFF
        self.lib.pll_reset(self.pll, angle, round(omega * T / (2.0 * math.pi) * 2**32))
        self._angle = angle
        self.slow(push=None)

    def fast(self, current: complex, voltage: complex) -> None:
        """One sample and the voltage commanded from it."""
        self.lib.back_emf_observer_step(self.observer, self._observer, ab(current, I_FS), ab(voltage, U_FS))
        self.lib.pll_step(self.pll, self._pll, self.observer.e)

    def slow(self, push: float | None = 0.0) -> None:
        """Slow tick; `push` is the current of the acceleration feed-forward of the PLL [A]."""
        self.pll.backwards = self.pll.integral < 0
        self.lib.back_emf_observer_set_speed(self.observer, self.pll.integral)
        self.lib.pll_adapt(self.pll, self._pll, frac16(abs(self.emf) / U_FS))
        rotation = (self.pll.angle - self._angle + 2**31) % 2**32 - 2**31
        self._angle = self.pll.angle
        if push is not None:
            emf = self.emf_dq
            beside = {"d": frac16(emf.real / U_FS), "q": frac16((emf.imag - PSI * self.omega) / U_FS)}
            self.lib.pll_feed_forward(self.pll, self._pll, frac16(push / I_FS), beside, rotation)

    @property
    def emf(self) -> complex:
        """Back-EMF in the stator frame [V]."""
        e = self.lib.back_emf_observer_emf(self.observer, self._observer)
        return complex(e.alpha, e.beta) / 32768 * U_FS

    @property
    def emf_dq(self) -> complex:
        """Back-EMF in the frame of the PLL [V]."""
        return self.emf * cmath.exp(-1j * self.lib.pll_theta_of_emf(self.pll) * math.pi / 32768)

    @property
    def theta(self) -> float:
        """Angle at the next sample [rad]."""
        return float(self.pll.angle) / 2**32 * 2.0 * math.pi

    @property
    def omega(self) -> float:
        """Electrical speed, the integral part of the PLL [rad/s]."""
        return float(self.pll.integral) / 2**32 * 2.0 * math.pi / T

    @property
    def speed(self) -> int:
        """Mechanical speed in the format of the firmware."""
        return int(self.lib.pll_speed_of(self._pll, self.pll.integral))


class Rig:
    """A motor with constant inductance, a shaft motion given by the test, and ideal current control.

    As with the inverter, the voltage of a sample acts half a period later for one period.
    """

    def __init__(self, core: Core, r: float = R, l_s: float = L) -> None:
        self.estimator = Estimator(core)
        self.r, self.l_s = r, l_s
        self.current = 0j
        self.commands = [0j, 0j]
        self.k = 0

    def step(self, theta: Callable[[float], float], i_q: float = 0.0) -> None:
        """One period: sample, command, and the motor until the next sample."""
        now = self.k * T
        set_point = 1j * i_q * cmath.exp(1j * theta(now))
        later = 1j * i_q * cmath.exp(1j * theta(now + T))
        flux = [PSI * cmath.exp(1j * theta(now + x * T)) for x in (0.5, 1.0, 1.5)]
        # drives the current to its set-point against the back-EMF of the period in which the voltage acts
        command = self.r * later + self.l_s * (later - set_point) / T + (flux[2] - flux[0]) / T
        command += 0.3 * self.l_s / T * (set_point - self.current)
        self.commands = [self.commands[1], command]
        self.estimator.fast(self.current, command)
        if self.k % SLOW == 0:
            self.estimator.slow()
        self._move(theta, now)
        self.k += 1

    def _move(self, theta: Callable[[float], float], now: float) -> None:
        parts = 8
        h = T / parts
        for j in range(parts):
            v = self.commands[0] if j < parts // 2 else self.commands[1]
            t = now + j * h
            e = PSI * (cmath.exp(1j * theta(t + h)) - cmath.exp(1j * theta(t))) / h
            a = math.exp(-self.r * h / self.l_s)
            self.current = a * self.current + (1.0 - a) / self.r * (v - e)

    def angle_error(self, theta: Callable[[float], float]) -> float:
        """Observed minus true angle at the next sample, electrical [rad]."""
        return wrapped(self.estimator.theta - theta(self.k * T))
