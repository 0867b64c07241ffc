"""The PLL on the observed back-EMF: lock in both directions, damping, torque feed-forward, load estimate."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from core_library import Core
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from observer_rig import FULL_SPEED, PAIRS, PSI, SLOW, U_FS, Estimator, Rig, T, wrapped


class Ideal:
    """The PLL alone, with the back-EMF of an ideal rotor."""

    def __init__(self, core: Core, flux: float = 1.0) -> None:
        self.estimator = Estimator(core)
        self.flux = flux
        self.k = 0

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self.k * T

    def step(
        self, theta: Callable[[float], float], omega: Callable[[float], float], push: float | None = None
    ) -> float:
        """Advance by one period; return the angle error [rad]."""
        it = self.estimator
        t = (self.k + 0.5) * T
        e = 1j * omega(t) * self.flux * PSI * complex(math.cos(theta(t)), math.sin(theta(t))) / U_FS
        bits = 2.0 ** (15 + it.config.observer.f2)
        it.observer.e.alpha, it.observer.e.beta = round(e.real * bits), round(e.imag * bits)
        it.lib.pll_step(it.pll, it.ffi.addressof(it.config, "pll"), it.observer.e)
        self.k += 1
        if self.k % SLOW == 0:
            it.slow(push)
        return wrapped(it.theta - theta(self.k * T))


def settle(core: Core, omega: float, offset: float, seconds: float) -> NDArray[np.float64]:
    """Angle errors after a start with the angle error `offset`."""
    ideal = Ideal(core)
    ideal.step(lambda t: omega * t, lambda _: omega)  # from here the back-EMF and the gain are known
    ideal.estimator.start(offset + omega * T, omega)
    return np.array([ideal.step(lambda t: omega * t, lambda _: omega) for _ in range(round(seconds / T))])


@pytest.mark.parametrize("omega", [32.0, -32.0, 150.0, -150.0, 730.0, -730.0])
def test_pll_locks_in_both_directions(core: Core, omega: float) -> None:
    errors = settle(core, omega, 0.3, 0.3)
    assert np.abs(errors[-200:]).max() < math.radians(0.2)


@pytest.mark.parametrize("omega", [32.0, 150.0, 730.0])
def test_damping_does_not_depend_on_the_speed(core: Core, omega: float) -> None:
    """With damping 1 an angle step has one overshoot of e^-2 (by the zero of the loop) at every speed."""
    errors = settle(core, omega, 0.3, 0.3)
    assert -0.16 < errors.min() / 0.3 < -0.10
    assert errors[int(np.argmin(errors)) :].max() < 0.01 * 0.3


def test_natural_frequency_grows_with_the_root_of_the_speed(core: Core) -> None:
    """The integral gain of the slide is constant: at four times the speed the error settles in half the time."""

    def time(omega: float) -> int:
        return int(np.argmin(settle(core, omega, 0.3, 0.2)))

    assert time(75.0) / time(300.0) == pytest.approx(2.0, rel=0.05)
    assert time(150.0) / time(600.0) == pytest.approx(2.0, rel=0.05)


def test_angle_wraps_without_drift(core: Core) -> None:
    rig = Rig(core)
    rig.estimator.start(0.0, 700.0)
    worst = 0.0
    for k in range(4000):
        rig.step(lambda t: 700.0 * t)
        if k > 1000:
            worst = max(worst, abs(rig.angle_error(lambda t: 700.0 * t)))
    assert 20 * 2.0 * math.pi < 700.0 * 4000 * T
    assert math.degrees(worst) < 0.5


ACCELERATION = 1.5 * PAIRS * PSI / 0.8e-5 * PAIRS  # electrical, of one ampere


def accelerate(core: Core, fed_forward: float, seconds: float = 0.08) -> float:
    """Largest angle error when 1 A accelerates the rotor from 200 rad/s and the PLL is fed forward `fed_forward` A."""
    rate = ACCELERATION
    ideal = Ideal(core)
    ideal.estimator.ignore_amplitude()
    ideal.estimator.start(0.0, 200.0)

    def omega(t: float) -> float:
        return 200.0 + rate * t

    def theta(t: float) -> float:
        return 200.0 * t + rate * t * t / 2.0

    return max(abs(ideal.step(theta, omega, fed_forward)) for _ in range(round(seconds / T)))


def test_acceleration_by_i_q_is_fed_forward(core: Core) -> None:
    assert math.degrees(accelerate(core, 1.0)) < 0.5
    assert math.degrees(accelerate(core, 0.0)) > 2.0


def test_load_torque_is_estimated(core: Core) -> None:
    """0.5 A against a load at constant speed: the missing acceleration is the load.

    Speed and angle have no error.
    """
    ideal = Ideal(core)
    ideal.estimator.start(0.0, 200.0)
    errors = [ideal.step(lambda t: 200.0 * t, lambda _: 200.0, 0.5) for _ in range(round(0.8 / T))]
    assert math.degrees(abs(np.mean(errors[-400:]))) < 0.1
    assert ideal.estimator.omega == pytest.approx(200.0, abs=0.5)
    per_tick = -ideal.estimator.pll.load / 2**32 * 2.0 * math.pi / T / (SLOW * T)
    assert per_tick == pytest.approx(0.5 * ACCELERATION, rel=0.02)


def test_load_step_changes_the_amplitude_of_the_back_emf(core: Core) -> None:
    """Loop of 24 Hz, half of the speed lost within 10 ms: the amplitude of the back-EMF corrects the speed at once."""

    def behind(follow: bool) -> float:
        ideal = Ideal(core)
        if not follow:
            ideal.estimator.ignore_amplitude()
        ideal.estimator.start(0.0, 32.0)
        rate, errors = 1600.0, []
        for _ in range(round(0.01 / T)):
            ideal.step(lambda t: 32.0 * t - rate * t * t / 2.0, lambda t: 32.0 - rate * t, 0.0)
            errors.append(ideal.estimator.omega - (32.0 - rate * ideal.time))
        return max(errors)

    assert behind(follow=True) < 3.0
    assert behind(follow=False) > 9.0


def test_amplitude_offset_is_compensated_by_the_phase(core: Core) -> None:
    """With a flux 20 % above nominal the speed is correct after the transient."""
    ideal = Ideal(core, flux=1.2)
    ideal.estimator.start(0.0, 200.0)
    for _ in range(round(1.5 / T)):
        error = ideal.step(lambda t: 200.0 * t, lambda _: 200.0, 0.0)
    assert ideal.estimator.omega == pytest.approx(200.0, abs=0.5)
    assert abs(math.degrees(error)) < 0.2


@settings(max_examples=60)
@given(
    e=st.tuples(*2 * [st.integers(-(2**30), 2**30)]),
    step=st.integers(-(2**31), 2**31 - 1),
    emf=st.integers(0, 32767),
    i_q=st.integers(-32768, 32767),
    beside=st.tuples(*2 * [st.integers(-32768, 32767)]),
    rotation=st.integers(-(2**31), 2**31 - 1),
)
def test_steps_stay_within_their_bound(
    core: Core, e: tuple[int, int], step: int, emf: int, i_q: int, beside: tuple[int, int], rotation: int
) -> None:
    estimator = Estimator(core)
    config = core.ffi.addressof(estimator.config, "pll")
    maximum = config.step_max
    core.lib.pll_reset(estimator.pll, 0, max(min(step, maximum), -maximum))
    for _ in range(40):
        core.lib.pll_adapt(estimator.pll, config, emf)
        core.lib.pll_feed_forward(estimator.pll, config, i_q, {"d": beside[0], "q": beside[1]}, rotation)
        core.lib.pll_step(estimator.pll, config, {"alpha": e[0], "beta": e[1]})
        assert abs(estimator.pll.integral) <= maximum
        assert abs(estimator.pll.step) <= maximum


def test_speeds_are_converted_to_steps_per_period(core: Core) -> None:
    config = core.ffi.addressof(Estimator(core).config, "pll")
    for rad_s in (1.0, -15.7, 314.0, -500.0):
        raw = round(rad_s / FULL_SPEED * 2**31)
        step = core.lib.pll_step_of(config, raw)
        assert step == pytest.approx(rad_s * PAIRS * T / (2.0 * math.pi) * 2**32, abs=2)
        assert core.lib.pll_speed_of(config, step) == pytest.approx(raw, abs=100)
