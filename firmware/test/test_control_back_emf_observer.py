"""The Luenberger observer: its equations in floating point, its bounds, and the true back-EMF of a motor."""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
import pytest
from core_library import Core
from hypothesis import given, settings
from hypothesis import strategies as st
from observer_rig import PSI, Estimator, L, R, Rig, T

FULL16 = st.integers(-32768, 32767)


class Model:
    """The equations of back_emf_observer.h in floating point, from the constants as the firmware has them."""

    def __init__(self, config: Any, step: int) -> None:
        c = config
        self.a = 1.0 - c.loss / 2**32
        self.b = c.drive / 2**32 * 2.0 ** (c.f2 - c.f1)
        self.k1, self.k2 = c.k1 / 2**31, c.k2 / 2**28 * 2.0 ** (c.f1 - c.f2)
        self.turn = cmath.exp(2j * math.pi * step / 2**32)
        self.i = self.e = self.v = 0j

    def step(self, current: complex, voltage: complex) -> None:
        error = self.i - current
        i = self.i + self.k1 * error
        self.e = (self.e + self.k2 * error) * self.turn
        self.i = self.a * i + self.b * ((self.v + voltage) / 2.0 - self.e)
        self.v = voltage


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), step=st.integers(-70_000_000, 70_000_000))
def test_observer_agrees_with_its_equations(core: Core, seed: int, step: int) -> None:
    estimator = Estimator(core)
    config = core.ffi.addressof(estimator.config, "observer")
    model = Model(estimator.config.observer, step)
    core.lib.back_emf_observer_set_speed(estimator.observer, step)
    rng = np.random.default_rng(seed)
    for raw in rng.integers(-20000, 20000, (300, 4)):
        i, v = complex(raw[0], raw[1]) / 32768, complex(raw[2], raw[3]) / 32768
        current = {"alpha": int(raw[0]), "beta": int(raw[1])}
        core.lib.back_emf_observer_step(
            estimator.observer, config, current, {"alpha": int(raw[2]), "beta": int(raw[3])}
        )
        model.step(i, v)
    state = estimator.observer
    scale = 2.0 ** (15 + estimator.config.observer.f1), 2.0 ** (15 + estimator.config.observer.f2)
    assert abs(complex(state.i.alpha, state.i.beta) / scale[0] - model.i) < 2e-6
    assert abs(complex(state.e.alpha, state.e.beta) / scale[1] - model.e) < 5e-6


@settings(max_examples=30)
@given(signs=st.lists(st.tuples(*4 * [st.sampled_from([-32768, 32767])]), min_size=1, max_size=6), step=FULL16)
def test_signals_stay_within_their_range(core: Core, signs: list[tuple[int, int, int, int]], step: int) -> None:
    """Sixteen times the full scale fits; the largest inputs of converter and modulator need less than ten."""
    estimator = Estimator(core)
    config = core.ffi.addressof(estimator.config, "observer")
    core.lib.back_emf_observer_set_speed(estimator.observer, step * 65536)
    for k in range(600):
        i_a, i_b, v_a, v_b = signs[k % len(signs)]
        core.lib.back_emf_observer_step(
            estimator.observer, config, {"alpha": i_a, "beta": i_b}, {"alpha": v_a, "beta": v_b}
        )
        for state in (estimator.observer.i, estimator.observer.e):
            assert max(abs(state.alpha), abs(state.beta)) < 10 * 2**26


@pytest.mark.parametrize("omega", [40.0, -40.0, 200.0, 730.0, -730.0])
@pytest.mark.parametrize("i_q", [0.0, 2.0])
def test_back_emf_has_no_bias(core: Core, omega: float, i_q: float) -> None:
    """Angle and amplitude at any speed and current, in the frame of DRM E13: e = j omega psi exp(j theta)."""
    rig = Rig(core)
    rig.estimator.start(0.3, omega)

    def theta(t: float) -> float:
        return 0.3 + omega * t

    errors = []
    for k in range(1200):
        rig.step(theta, i_q)
        if k > 800:
            middle = theta((rig.k - 0.5) * T)
            errors.append(rig.estimator.emf / (1j * omega * PSI * cmath.exp(1j * middle)))
    mean = sum(errors) / len(errors)
    assert abs(math.degrees(cmath.phase(mean))) < 0.15
    assert abs(mean) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("r", "l_s", "maximum"), [(0.5, 1.0, 1.0), (1.5, 1.0, 1.0), (1.0, 0.5, 4.0), (1.0, 1.5, 4.0)])
def test_angle_error_by_a_wrong_nominal_value_agrees_with_theory(
    core: Core, r: float, l_s: float, maximum: float
) -> None:
    """ST slide "Performance of the control": low sensitivity to R_s, moderate to L_s.

    With i_d = 0, R changes only the amplitude of e, and L rotates it by delta_L i_q / psi.
    """
    rig = Rig(core, R * r, L * l_s)
    omega, i_q = 300.0, 2.0
    rig.estimator.start(0.0, omega)
    for _ in range(16000):  # time for the PLL to estimate the amplitude error
        rig.step(lambda t: omega * t, i_q)
    error = math.degrees(rig.angle_error(lambda t: omega * t))
    assert abs(error) < maximum
    assert error == pytest.approx(math.degrees(L * (l_s - 1.0) * i_q / PSI), abs=0.4)


def test_rotation_of_the_back_emf_is_exact(core: Core) -> None:
    observer = core.ffi.new("back_emf_observer_t *")
    for step in (0, 1, -12345, 44_739_243, -89_478_485, 160_000_000):
        core.lib.back_emf_observer_set_speed(observer, step)
        angle = 2.0 * math.pi * step / 2**32
        assert observer.rotation_sin / 2**32 == pytest.approx(math.sin(angle), abs=1e-5)
        assert observer.rotation_versine / 2**32 == pytest.approx(1.0 - math.cos(angle), abs=1e-5)
