"""The current loop: decoupling, bus-ripple compensation, voltage limit, dead time, and its step response."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from core_library import Core
from exact import (
    GAIN_ONE,
    I16,
    I32,
    MAX16,
    MIN16,
    clip,
    clip16,
    clip32,
    edges,
    narrow,
    near,
    nearest,
    product,
    saturated,
    times_gain,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st

U_FS, I_FS, UDC_FS = 24.2, 8.25, 36.3
OMEGA_FS = 2 * 5000.0 * math.pi / 30.0  # electrical
BUS_24V = 21664
SQRT3 = math.sqrt(3.0)
LINEAR = int(SQRT3 / 2.0 * 32768)
MOTOR = {"r": 0.55, "l_d": 0.403e-3, "l_q": 0.512e-3, "psi": 0.0154}  # nominal values of axis 1 in servo.toml


def frac16(x: float) -> int:
    return min(max(round(x * 32768), -32768), 32767)


class Loop:
    """The C current loop in volts, amperes and radians."""

    def __init__(self, core: Core, dead_time: bool = False, controllers: bool = True) -> None:
        self._core = core
        self.config: Any = core.ffi.new("current_loop_config_t *", core.lib.probe_config().axis[0].current_loop)
        if not dead_time:
            self.config.dead_time.duty = 0
            self.config.dead_time.v_drop = 0
        if not controllers:
            for gains in (self.config.d, self.config.q):
                gains.kp = gains.ki = gains.kc = 0
        self._state = core.ffi.new("current_loop_t *")
        core.lib.current_loop_reset(self._state)

    def step(
        self, i_dq: complex = 0j, reference: complex = 0j, theta: float = 0.0, omega: float = 0.0, bus: int = BUS_24V
    ) -> Any:
        """One period with the currents of a rotor frame [A]; theta and omega electrical [rad, rad/s]."""
        i = i_dq * complex(math.cos(theta), math.sin(theta))
        phases = [frac16((i * complex(-0.5, -SQRT3 / 2.0) ** k).real / I_FS) for k in range(3)]
        angle = round(theta / math.pi * 32768) & 0xFFFF
        return self._core.lib.probe_current_loop(
            self._state,
            self.config,
            dict(zip("abc", phases, strict=True)),
            {"d": frac16(reference.real / I_FS), "q": frac16(reference.imag / I_FS)},
            angle - 65536 if angle >= 32768 else angle,
            frac16(omega / OMEGA_FS),
            bus,
        )


def dq_volts(out: Any) -> complex:
    return complex(out.voltage.d, out.voltage.q) / 32768 * U_FS


def stator_volts(out: Any, bus: int) -> complex:
    """Mean stator voltage of the duties at this bus voltage [V]."""
    a = complex(-0.5, SQRT3 / 2.0)
    duty = (out.modulation.duty.a, out.modulation.duty.b, out.modulation.duty.c)
    return complex(2.0 / 3.0 * bus / 32768 * UDC_FS * sum(d / 32767 * a**k for k, d in enumerate(duty)))


def real_times(x: int, gain: int) -> float:
    """Product of a Q1.31 fraction and a gain, saturated."""
    return min(max(x * gain / GAIN_ONE, -(2.0**31)), 2.0**31 - 1.0)


def check_controller(
    config: Any, before: tuple[int, int], after: Any, error: int, forward: float, limit: int, out: int
) -> None:
    """E35..E37 in reals: 3 LSB of Q1.31 in the state, half an LSB of Q1.15 in the voltage.

    A voltage that is rounded to the limit does not count as limited.
    """
    integral = before[0] + (error * config.ki + before[1] * config.kc) / GAIN_ONE
    integral = min(max(integral, -(2.0**31)), 2.0**31 - 1.0)
    requested = error * config.kp / GAIN_ONE + integral + forward
    voltage = min(max(requested, -limit * 65536.0), limit * 65536.0)
    excess = min(max(voltage - requested, -(2.0**31)), 2.0**31 - 1.0)
    assert abs(after.integral / GAIN_ONE - integral) <= 3.0
    assert abs(after.excess - excess) <= 8.0 or (after.excess == 0 and abs(excess) <= 32768)
    assert abs(out - min(max(voltage / 65536.0, MIN16), MAX16)) <= 0.501


@given(
    phases=st.tuples(I16, I16, I16),
    reference=st.tuples(I16, I16),
    theta=I16,
    omega=I16,
    bus=I16,
    states=st.tuples(st.tuples(I32, I32), st.tuples(I32, I32)),
    axis=st.integers(0, 1),
    modulation_limit=st.one_of(st.none(), edges(0, LINEAR)),
)
@settings(max_examples=400)
def test_a_step_stays_close_to_reals_over_the_whole_range(
    core: Core,
    phases: tuple[int, int, int],
    reference: tuple[int, int],
    theta: int,
    omega: int,
    bus: int,
    states: tuple[tuple[int, int], tuple[int, int]],
    axis: int,
    modulation_limit: int | None,
) -> None:
    """One step from any input and any state, stage by stage against reals.

    Current: 3.3 LSB (clarke half an LSB in both components, rotation 2.52). Controllers: see `check_controller`, from
    the measured current. Duties: 2.52 LSB of the voltage, half an LSB of the angle, and 2.3 LSB of the SVM.
    """
    config: Any = core.ffi.new("current_loop_config_t *", core.lib.probe_config().axis[axis].current_loop)
    if modulation_limit is not None:
        config.modulation_limit = modulation_limit
    loop: Any = core.ffi.new("current_loop_t *", {"dead_time_off": True})
    for controller, (integral, excess) in zip((loop.d, loop.q), states, strict=True):
        controller.integral, controller.excess = integral * GAIN_ONE, excess
    out = core.lib.probe_current_loop(loop, config, phases, reference, theta, omega, bus)

    a, b, c = phases
    alpha, beta = (min(max(x, MIN16), MAX16) for x in ((2 * a - b - c) / 3.0, (b - c) / SQRT3))
    i = complex(alpha, beta) * complex(math.cos(math.pi * theta / 32768), -math.sin(math.pi * theta / 32768))
    assert abs(out.current.d - min(max(i.real, MIN16), MAX16)) <= 3.3
    assert abs(out.current.q - min(max(i.imag, MIN16), MAX16)) <= 3.3

    bus = max(bus, 8192)
    limit = product(bus, config.modulation_limit)
    i_d, i_q = out.current.d, out.current.q
    errors = [clip(r - x, MIN16, MAX16) * 65536 for r, x in zip(reference, (i_d, i_q), strict=True)]
    forward_d = -2 * omega * i_q * config.omega_l_q / GAIN_ONE
    forward_q = (2 * omega * i_d * config.omega_l_d + omega * 65536 * config.omega_psi) / GAIN_ONE
    check_controller(config.d, states[0], loop.d, errors[0], forward_d, limit, out.voltage.d)
    rest = math.isqrt(limit**2 - out.voltage.d**2)
    check_controller(config.q, states[1], loop.q, errors[1], forward_q, rest, out.voltage.q)
    assert out.limited == (loop.d.excess != 0 or loop.q.excess != 0)

    u = complex(out.voltage.d, out.voltage.q)
    angle = math.pi * (theta / 32768 + real_times(omega * 65536, config.angle_step) / 2**31)
    requested = u / bus * complex(math.cos(angle), math.sin(angle))
    duty = [out.modulation.duty.a, out.modulation.duty.b, out.modulation.duty.c]
    a120 = complex(-0.5, SQRT3 / 2.0)
    got = sum(d * a120**k for k, d in enumerate(duty))
    off = (2.52 * math.sqrt(2.0) + abs(u) * math.pi / 65536) * 32768 / bus + 1.5 + 3.0 * 2.3
    assert abs(got - requested * 32767) <= off


class Model:
    """The current loop in integers: transforms, SVM and dead time are those of the firmware, tested by themselves."""

    def __init__(self, core: Core, config: Any, states: Sequence[tuple[int, int]]) -> None:
        self._lib, self._config = core.lib, config
        self.integral = [saturated(integral * GAIN_ONE) for integral, _ in states]
        self.excess = [excess for _, excess in states]
        self.voltage = (0, 0)

    def _sums(self, currents: tuple[int, int], reference: Sequence[int], omega: int) -> list[int]:
        """E34 to E36 with E18, E19: exact, 55 fraction bits."""
        c, (d, q) = self._config, currents
        forward = [-2 * omega * q * c.omega_l_q, 2 * omega * d * c.omega_l_d + omega * 2**16 * c.omega_psi]
        sums = []
        for k, gains in enumerate((c.d, c.q)):
            error = clip16(reference[k] - currents[k]) * 2**16
            self.integral[k] = saturated(self.integral[k] + error * gains.ki + self.excess[k] * gains.kc)
            sums.append(self.integral[k] + error * gains.kp + forward[k])
        return sums

    def _limited(self, k: int, sum_: int, limit: int) -> int:
        """E37 with 31 bits, the result with 15."""
        requested = nearest(sum_, GAIN_ONE)
        out = clip(requested, -limit * 2**16, limit * 2**16)
        self.excess[k] = clip32(out - requested)
        return narrow(out)

    def _ahead(self, theta: int, omega: int) -> dict[str, int]:
        """Sine and cosine one period later, by the rotation of the vector."""
        at = self._lib.sin_cos(theta)
        turn = self._lib.sin_cos(narrow(times_gain(omega * 2**16, self._config.angle_step)))
        versine = MAX16 - max(turn.cos, 0)
        return {
            "sin": clip16(at.sin + nearest(at.cos * turn.sin - at.sin * versine, 2**15)),
            "cos": clip16(at.cos - nearest(at.sin * turn.sin + at.cos * versine, 2**15)),
        }

    def step(
        self, phases: Sequence[int], reference: Sequence[int], theta: int, omega: int, bus: int, dead_time: bool
    ) -> tuple[tuple[int, int], bool, list[int]]:
        """Currents, whether the voltage is limited, duties and sector."""
        current = dict(zip("abc", phases, strict=True))
        i = self._lib.park(self._lib.clarke(current), self._lib.sin_cos(theta))
        bus = max(bus, 8192)
        limit = product(bus, self._config.modulation_limit)
        sums = self._sums((i.d, i.q), reference, omega)
        d, q = (clip16(nearest(sum_, 2**40)) for sum_ in sums)
        limited = d * d + q * q > limit * limit
        if limited:
            if abs(d) <= limit:
                self.excess[0] = 0
            else:
                d = self._limited(0, sums[0], limit)
            q = self._limited(1, sums[1], math.isqrt(limit**2 - d**2))
        else:
            self.excess = [0, 0]
        self.voltage = (d, q)
        u = self._lib.park_inverse({"d": d, "q": q}, self._ahead(theta, omega))
        reciprocal = 2**29 // bus
        modulation = {x: clip16(nearest(getattr(u, x) * reciprocal, 2**14)) for x in ("alpha", "beta")}
        out = self._lib.svm(modulation)
        duty = out.duty
        if dead_time:
            duty = self._lib.dead_time_compensate([self._config.dead_time], duty, current, reciprocal)
        return (i.d, i.q), limited, [duty.a, duty.b, duty.c, out.sector]


GAINS = st.tuples(*[edges(-40 * GAIN_ONE, 40 * GAIN_ONE)] * 2, edges(0, GAIN_ONE))
SAMPLE = st.tuples(st.tuples(I16, I16, I16), st.tuples(I16, I16), I16, I16, I16)


@given(
    gains=st.tuples(GAINS, GAINS),
    couplings=st.tuples(*[edges(-40 * GAIN_ONE, 40 * GAIN_ONE)] * 3),
    angle_step=edges(0, GAIN_ONE),
    modulation_limit=edges(0, MAX16),
    states=st.tuples(st.tuples(I32, I32), st.tuples(I32, I32)),
    samples=st.lists(SAMPLE, min_size=1, max_size=4),
    small=st.booleans(),
    dead_time=st.booleans(),
)
@settings(max_examples=300)
def test_agrees_with_integers_in_every_bit(
    core: Core,
    gains: tuple[tuple[int, ...], tuple[int, ...]],
    couplings: tuple[int, int, int],
    angle_step: int,
    modulation_limit: int,
    states: tuple[tuple[int, int], tuple[int, int]],
    samples: list[tuple[tuple[int, ...], tuple[int, int], int, int, int]],
    small: bool,
    dead_time: bool,
) -> None:
    """Any gains that fit one sum, any input, within the voltage circle (small numbers) and on it."""
    config: Any = core.ffi.new("current_loop_config_t *", core.lib.probe_config().axis[0].current_loop)
    scale = 64 if small else 1
    (config.d.kp, config.d.ki, config.d.kc), (config.q.kp, config.q.ki, config.q.kc) = (
        (kp // scale, ki // scale, kc) for kp, ki, kc in gains
    )
    config.omega_l_d, config.omega_l_q, config.omega_psi = (x // scale for x in couplings)
    config.angle_step, config.modulation_limit = angle_step, modulation_limit
    d, q = ((integral // scale**2, excess // scale) for integral, excess in states)
    model = Model(core, config, (d, q))
    loop: Any = core.ffi.new("current_loop_t *", {"dead_time_off": not dead_time})
    for controller, integral, excess in zip((loop.d, loop.q), model.integral, model.excess, strict=True):
        controller.integral, controller.excess = integral, excess
    for phases, reference, theta, omega, bus in samples:
        inputs = [x // scale for x in phases], [x // scale for x in reference], theta, omega, bus
        out = core.lib.probe_current_loop(loop, config, *inputs)
        current, limited, modulation = model.step(*inputs, dead_time)
        assert (out.current.d, out.current.q) == current
        assert (out.voltage.d, out.voltage.q) == model.voltage
        assert out.limited == limited
        assert [loop.d.integral, loop.q.integral] == model.integral
        assert [loop.d.excess, loop.q.excess] == model.excess
        duty = out.modulation.duty
        assert [duty.a, duty.b, duty.c, out.modulation.sector] == modulation


@given(omega=I16, angle_step=I32)
@settings(max_examples=200)
def test_every_bit_of_the_rotation_per_period(core: Core, omega: int, angle_step: int) -> None:
    """Values computed from the speed: rotation per period, its sine and versine for the nearest angle."""
    config: Any = core.ffi.new("current_loop_config_t *", core.lib.probe_config().axis[0].current_loop)
    config.angle_step = angle_step
    loop: Any = core.ffi.new("current_loop_t *")
    core.lib.current_loop_set_speed(loop, config, omega)
    turn = core.lib.sin_cos(clip16(nearest(omega * angle_step, 2**24)))
    assert (loop.omega_e, loop.minus_2_omega) == (omega * 2**16, -2 * omega)
    assert (loop.rotation_sin, loop.rotation_versine) == (turn.sin, MAX16 - max(turn.cos, 0))


@given(theta=I16, turn=edges(-(2**14), 2**14))
@settings(max_examples=400)
def test_angle_advance_of_the_duties(core: Core, theta: int, turn: int) -> None:
    """Up to a quarter revolution ahead: at most 3.5 LSB off the sine and cosine of the sum of both angles.

    1.01 LSB of sine and cosine, 1.5 LSB of those of the rotation, 0.5 LSB of the rounding, less for 1 - cosine.
    """
    sin_cos = core.lib.sin_cos
    loop: Any = core.ffi.new("current_loop_t *", {"rotation_sin": sin_cos(turn).sin})
    loop.rotation_versine = MAX16 - sin_cos(turn).cos
    ahead = core.lib.current_loop_ahead(loop, sin_cos(theta))
    angle = math.pi * (theta + turn) / 32768
    assert abs(ahead.sin - 32768 * math.sin(angle)) <= 3.5
    assert abs(ahead.cos - 32768 * math.cos(angle)) <= 3.5
    at, s, v = sin_cos(theta), loop.rotation_sin, loop.rotation_versine
    assert ahead.sin == clip16(at.sin + nearest(at.cos * s - at.sin * v, 2**15))
    assert ahead.cos == clip16(at.cos - nearest(at.sin * s + at.cos * v, 2**15))


@given(u=I16, bus=edges(8192, MAX16))
@example(u=4096, bus=16385)  # a half, upwards
@example(u=-4096, bus=16385)
@settings(max_examples=200)
def test_every_ratio_of_voltage_and_bus_is_within_its_bound(core: Core, u: int, bus: int) -> None:
    """u / u_dc: half an LSB, and up to 2 for the truncated reciprocal."""
    part = core.lib.current_loop_over_bus(u, 2**29 // bus)
    assert part == clip16(nearest(u * (2**29 // bus), 2**14))
    assert abs(part - min(max(u * 2**15 / bus, MIN16), MAX16)) <= 0.5 + abs(u) / 2**14


@given(
    total=st.one_of(
        edges(-255 << 55, 255 << 55), near(*(k << 39 for k in (-(2**16) - 1, -(2**16) + 1, -3, -1, 1, 3, 2**16 - 1)))
    )
)
def test_sum_is_rounded_once(core: Core, total: int) -> None:
    """55 fraction bits to 15, halves upwards, saturated; the gains of a sum stay below 255 together."""
    assert core.lib.current_loop_rounded(total) == clip16(nearest(total, 2**40))


def test_a_reset_clears_currents_voltages_and_integrators(core: Core) -> None:
    loop: Any = core.ffi.new("current_loop_t *")
    core.ffi.memmove(loop, b"\x01" * core.ffi.sizeof("current_loop_t"), core.ffi.sizeof("current_loop_t"))
    core.lib.current_loop_reset(loop)
    assert (loop.current.d, loop.current.q, loop.voltage.d, loop.voltage.q, loop.limited) == (0, 0, 0, 0, False)
    assert (loop.d.integral, loop.d.excess, loop.q.integral, loop.q.excess) == (0, 0, 0, 0)
    assert (loop.omega_e, loop.minus_2_omega, loop.rotation_sin, loop.rotation_versine) == (0, 0, 0, 0)
    assert loop.dead_time_off  # a choice, not a state


@given(
    i=st.tuples(st.floats(-5.5, 5.5), st.floats(-5.5, 5.5)),
    reference=st.tuples(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0)),
    theta=st.floats(-math.pi, math.pi),
    omega=st.floats(-OMEGA_FS, OMEGA_FS),
    bus=st.integers(0, 32767),
)
def test_the_voltage_stays_within_a_circle(
    core: Core, i: tuple[float, float], reference: tuple[float, float], theta: float, omega: float, bus: int
) -> None:
    """A circle below the linear range for any input, with duties that leave two low sides on for a sample."""
    loop = Loop(core)
    for _ in range(3):
        out = loop.step(complex(*i), complex(*reference), theta, omega, bus)
    limit = max(bus, 8192) / 32768 * loop.config.modulation_limit / 32768 * U_FS
    assert abs(dq_volts(out)) <= limit + 2e-3
    if abs(dq_volts(out)) < 0.99 * limit:
        assert not out.limited
    duty = sorted((out.modulation.duty.a, out.modulation.duty.b, out.modulation.duty.c))
    assert duty[1] <= 0.92 * 32768
    assert duty[0] >= 0.0
    assert duty[2] <= 32767


@pytest.mark.parametrize("omega", [0.0, 600.0, -600.0])
def test_step_response_on_a_motor(core: Core, omega: float) -> None:
    """Closed loop with E18..E21 and half a period of delay: i_q steps to 2 A at 1 kHz bandwidth, i_d hardly changes."""
    loop, ts, steps = Loop(core), 1.0 / 16000.0, 10
    i, theta, duty_volts = 0j, 0.3, 0j
    log = []
    for k in range(160):
        out = loop.step(i, 2.0j if k >= 80 else 0j, theta, omega)
        for n in range(steps):
            if n == steps // 2:
                duty_volts = stator_volts(out, BUS_24V)
            u = duty_volts * complex(math.cos(theta), -math.sin(theta))
            d_i = complex(
                (u.real - MOTOR["r"] * i.real + omega * MOTOR["l_q"] * i.imag) / MOTOR["l_d"],
                (u.imag - MOTOR["r"] * i.imag - omega * (MOTOR["l_d"] * i.real + MOTOR["psi"])) / MOTOR["l_q"],
            )
            i += d_i * ts / steps
            theta = (theta + omega * ts / steps + math.pi) % (2 * math.pi) - math.pi
        log.append(i)
    before, after = np.array(log[40:80]), np.array(log[80:])
    assert np.max(np.abs(before)) < 0.05
    assert np.max(after.imag) < 2.0 * 1.15
    assert after[7].imag > 1.5  # 0.5 ms; at +600 rad/s the voltage is limited
    assert after[-20:].imag == pytest.approx(2.0, abs=0.04)
    assert np.max(np.abs(after.real)) < 0.25
    assert after[-20:].real == pytest.approx(0.0, abs=0.04)


def test_anti_windup_of_the_current_loop(core: Core) -> None:
    """After a second at the voltage limit the loop leaves it within a few periods."""
    loop = Loop(core)
    for _ in range(2000):
        out = loop.step(reference=4.0j)  # no current: the loop stays at the voltage limit
    assert out.limited
    for _ in range(3):
        out = loop.step(i_dq=4.5j, reference=4.0j)
    assert not out.limited
