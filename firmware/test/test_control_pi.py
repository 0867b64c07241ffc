"""PI controller with back-calculation anti-windup (DRM E34..E37)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from core_library import Core
from exact import FRACTION32, GAIN_ONE, I32, clip, clip32, edges, nearest, saturated
from hypothesis import given, settings
from hypothesis import strategies as st

ONE = 2**31


def raw(x: float) -> int:
    return min(max(round(x * ONE), -ONE), ONE - 1)


class Controller:
    """The C controller in numbers between -1 and 1."""

    def __init__(self, core: Core, kp: float, ki: float, kc: float) -> None:
        self._lib = core.lib
        self._gains = core.ffi.new("pi_gains_t *", [round(k * GAIN_ONE) for k in (kp, ki, kc)])
        self.state: Any = core.ffi.new("pi_state_t *")
        self._lib.pi_reset(self.state, 0)

    def step(self, error: float, limit: float, feed_forward: float = 0.0) -> float:
        return float(self._lib.probe_pi(self.state, self._gains, raw(error), raw(feed_forward), raw(limit)) / ONE)

    @property
    def integral(self) -> float:
        return float(self.state.integral / ONE / GAIN_ONE)


def test_example_calculated_by_hand(core: Core) -> None:
    """Kp = 1/2, Kp Ki Ts = 1/4, Kc = 1/2, limit 3/8, error 1/2, 1/2, -1/4: all numbers are exact."""
    pi = Controller(core, 0.5, 0.25, 0.5)
    # k = 1: u_p = 1/4, u_i = 1/8, u_presat = 3/8: just not limited
    assert pi.step(0.5, 0.375) == 0.375
    assert pi.integral == 0.125
    assert pi.state.excess == 0
    # k = 2: u_i = 1/4, u_presat = 1/2: limited by 1/8
    assert pi.step(0.5, 0.375) == 0.375
    assert pi.integral == 0.25
    assert pi.state.excess / ONE == -0.125
    # k = 3: u_c = -1/16 goes into the integrator: u_i = 1/4 - 1/16 - 1/16 = 1/8; u_p = -1/8; u = 0
    assert pi.step(-0.25, 0.375) == 0.0
    assert pi.integral == 0.125


def test_without_anti_windup_the_output_leaves_its_limit_later(core: Core) -> None:
    pi = Controller(core, 0.5, 0.25, 0.0)
    for _ in range(2):
        pi.step(0.5, 0.375)
    assert pi.step(-0.25, 0.375) == 0.0625  # u_i = 1/4 - 1/16, u_p = -1/8


@given(
    samples=st.lists(st.tuples(I32, I32, FRACTION32), min_size=1, max_size=12),
    gains=st.tuples(I32, I32, edges(0, GAIN_ONE)),
    start=st.tuples(I32, I32),
)
@settings(max_examples=400)
def test_every_bit_over_the_whole_range(
    core: Core, samples: Sequence[tuple[int, int, int]], gains: tuple[int, int, int], start: tuple[int, int]
) -> None:
    """E35..E37 in integers: sums of exact products, the integral and the excess saturated, one rounding at the end."""
    kp, ki, kc = gains
    integral, excess = start[0] * GAIN_ONE, start[1]
    state, g = core.ffi.new("pi_state_t *", (integral, excess)), core.ffi.new("pi_gains_t *", gains)
    for error, forward, limit in samples:
        integral = saturated(integral + error * ki + excess * kc)
        unlimited = nearest(integral + error * kp + forward * GAIN_ONE, GAIN_ONE)
        out = clip(unlimited, -limit, limit)
        excess = clip32(out - unlimited)
        assert core.lib.probe_pi(state, g, error, forward, limit) == out
        assert (state.integral, state.excess) == (integral, excess)


def test_a_reset_sets_the_integrator_and_clears_the_excess(core: Core) -> None:
    state = core.ffi.new("pi_state_t *", (1, 2))
    core.lib.pi_reset(state, -ONE)
    assert (state.integral, state.excess) == (-ONE * GAIN_ONE, 0)


def speed_loop(core: Core, anti_windup: bool) -> tuple[float, float]:
    """DRM F21/F22: 500 rpm and 20 Hz, no load, 1 A; overshoot [rpm] and lag [deg] of the shaft of axis 1."""
    ts, k_t, inertia, friction = 0.5e-3, 0.0462, 0.8e-5, 2e-3
    amplitude, omega = 500.0 * np.pi / 30.0, 2.0 * np.pi * 20.0
    gains = core.lib.probe_config().axis[0].speed
    pi = Controller(core, gains.kp / GAIN_ONE, gains.ki / GAIN_ONE, gains.kc / GAIN_ONE if anti_windup else 0.0)
    speed, log = 0.0, []
    time = np.arange(0.0, 4.0 / 20.0, ts)
    for reference in amplitude * np.sin(omega * time):
        torque = k_t * 8.25 * pi.step((reference - speed) / 523.6, 1.0 / 8.25)
        for _ in range(10):
            drag = friction * np.sign(speed) if abs(speed) > 0.1 else np.clip(torque, -friction, friction)
            speed += (torque - drag) / inertia * ts / 10.0
        log.append(speed)
    steady = slice(len(log) // 4, None)  # three whole periods
    shaft = np.vdot(np.exp(1j * omega * time[steady]), np.array(log)[steady])
    overshoot = (np.max(np.abs(log[steady])) - amplitude) * 30.0 / np.pi
    return float(overshoot), float(-90.0 - np.degrees(np.angle(shaft)))


def test_speed_loop_of_f21_and_f22(core: Core) -> None:
    """With anti-windup almost no overshoot and a small lag; without, overshoot and lag at every peak."""
    overshoot, lag = speed_loop(core, anti_windup=True)
    plain_overshoot, plain_lag = speed_loop(core, anti_windup=False)
    assert overshoot < 25.0  # 5 % of the amplitude
    assert lag < 15.0
    assert plain_overshoot > 100.0
    assert plain_lag > lag + 10.0
