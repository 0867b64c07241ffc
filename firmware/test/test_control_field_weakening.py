"""Field weakening: every bit against integers, bounds of its set-points, and the loop on a model of the motor."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import pytest
from core_library import Core
from exact import FRACTION16, I16, clip, clip16, clip32, edges
from hypothesis import given, settings
from hypothesis import strategies as st

ONE = 2**15
VOLT, AMP = ONE / 24.2, ONE / 8.25
Q16 = 2**16


@dataclass
class Config:
    """``field_weakening_config_t``; by default that of axis 1 in servo.toml."""

    margin: int = round(0.3 * VOLT)
    gain: int = 257
    i_d_max: int = round(3.0 * AMP)
    q_share: int = 18382


def slew_of(config: Config) -> int:
    """Largest change of i_d in a step."""
    return config.i_d_max * Q16 >> 3


@dataclass
class Input:
    """``field_weakening_input_t``, raw."""

    d: int = 0
    q: int = 0
    u_max: int = round(13.0 * VOLT)
    emf: int = round(13.0 * VOLT)
    current: int = round(4.0 * AMP)
    enabled: bool = True


@dataclass
class Weakening:
    """The C code and the same computation in Python integers."""

    core: Core
    config: Config
    d: int = 0
    q: int = 0

    def __post_init__(self) -> None:
        c = self.config
        self._config = self.core.ffi.new("field_weakening_config_t *")
        for name in ("margin", "gain", "i_d_max", "q_share"):
            setattr(self._config, name, getattr(c, name))
        self.state = self.core.ffi.new("field_weakening_t *")

    def step(self, given: Input) -> tuple[int, int, int]:
        """i_d, i_q_max and i_q_motoring of the C."""
        it = self.core.ffi.new("field_weakening_input_t *")
        it.demand.d, it.demand.q = given.d, given.q
        it.u_max, it.emf, it.current, it.enabled = given.u_max, given.emf, given.current, given.enabled
        self.core.lib.field_weakening_step(self.state, self._config, it)
        lib = self.core.lib
        return lib.field_weakening_i_d(self.state), int(self.state.i_q_max), lib.field_weakening_motoring(self.state)

    def expect(self, given: Input) -> tuple[int, int, int]:
        """The same computation in unlimited integers."""
        c = self.config
        target = max(given.u_max - c.margin, 0)
        end = min(c.i_d_max, given.current - (given.current >> 3)) * Q16
        slew = slew_of(c)
        change = -slew
        unneeded = not given.enabled and abs(given.emf) <= given.u_max
        if not unneeded and 2 * min(abs(given.emf), ONE) > target:
            squares = sum(min(2 * u * u, 2**31 - 1) for u in (given.d, given.q))
            room = clip32(2 * target * target - squares)
            change = clip(-room * c.gain >> 8, -slew, slew)
            change = change if given.enabled else min(change, 0)
        q_moves = self.d >= end if change > 0 else self.q > 0
        if not q_moves:
            self.d = self.d + change
        self.d = clip(self.d, 0, end)
        i_d = -(self.d >> 16)
        root = math.isqrt((2 * given.current**2 - 2 * i_d**2) // 2)
        if q_moves:
            self.q += change * c.q_share >> 15
        self.q = clip(self.q, 0, root * Q16)
        return i_d, root, clip16(root - (self.q >> 16))


CONFIGS = st.builds(Config, margin=FRACTION16, gain=FRACTION16, i_d_max=FRACTION16, q_share=edges(1, ONE - 1))
INPUTS = st.builds(Input, d=I16, q=I16, u_max=FRACTION16, emf=I16, current=FRACTION16, enabled=st.booleans())


@given(config=CONFIGS, inputs=st.lists(INPUTS, min_size=1, max_size=20), current=FRACTION16)
@settings(max_examples=400)
def test_agrees_with_integers_in_every_bit(core: Core, config: Config, inputs: list[Input], current: int) -> None:
    """Over the whole range of all inputs, with a constant and a changing current limit."""
    for keeps in (True, False):
        weakening = Weakening(core, config)
        for given_ in inputs:
            if keeps:
                given_.current = current
            i_d, i_q_max, motoring = weakening.step(given_)
            expected = weakening.expect(given_)
            assert i_d == expected[0]
            assert abs(i_q_max - expected[1]) <= 1  # the root of the firmware may be one less
            weakening.q = int(weakening.state.q)
            assert motoring == i_q_max - (weakening.q >> 16)


@given(config=CONFIGS, inputs=st.lists(INPUTS, min_size=1, max_size=30))
def test_currents_stay_within_their_bounds(core: Core, config: Config, inputs: list[Input]) -> None:
    """Within the circle, never field-strengthening, within the slew rate; i_q is reduced only at the maximum i_d."""
    weakening = Weakening(core, config)
    before = (0, 0)
    for given_ in inputs:
        given_.current = max(given_.current, config.i_d_max)  # a falling limit is followed immediately
        i_d, i_q_max, motoring = weakening.step(given_)
        now = int(weakening.state.d), int(weakening.state.q)
        assert -config.i_d_max <= i_d <= 0
        assert i_d**2 + i_q_max**2 <= given_.current**2
        assert 0 <= motoring <= i_q_max
        assert abs(now[0] - before[0]) <= slew_of(config)
        assert now[1] == 0 or now[0] >= config.i_d_max * Q16
        before = now


def test_i_d_is_used_before_i_q_and_released_after_it(core: Core) -> None:
    weakening, config = Weakening(core, Config()), Config()
    long, short = Input(q=round(14.0 * VOLT)), Input(q=round(11.0 * VOLT))
    order = []
    for given_ in [long] * 40 + [short] * 40:
        _, i_q_max, motoring = weakening.step(given_)
        order.append((int(weakening.state.d) >> 16, i_q_max - motoring))
    deepest = next(k for k, (d, _) in enumerate(order) if d == config.i_d_max)
    assert all(q == 0 for _, q in order[: deepest + 1])
    assert order[39] == (config.i_d_max, i_q_of(config, Input().current))  # no motoring current remains
    given_back = next(k for k, (_, q) in enumerate(order) if k >= 40 and q == 0)
    assert all(d == config.i_d_max for d, _ in order[40 : given_back + 1])
    assert order[-1] == (0, 0)


def i_q_of(config: Config, current: int) -> int:
    return math.isqrt(current**2 - config.i_d_max**2)


@pytest.mark.parametrize(
    "given_",
    [
        pytest.param(Input(q=round(14.0 * VOLT), enabled=False), id="disabled"),
        pytest.param(Input(q=round(14.0 * VOLT), emf=round(6.0 * VOLT)), id="a transient at a low speed"),
        pytest.param(Input(q=round(14.0 * VOLT), emf=-round(6.0 * VOLT)), id="the same in the other direction"),
    ],
)
def test_field_weakening_is_released_at_the_slew_rate(core: Core, given_: Input) -> None:
    weakening, config = Weakening(core, Config()), Config()
    for _ in range(3):
        weakening.step(Input(q=round(14.0 * VOLT)))
    assert weakening.state.d > 0
    assert weakening.state.q == 0
    depths = [int(weakening.state.d)]
    while depths[-1] > 0:
        i_d, _, motoring = weakening.step(given_)
        depths.append(int(weakening.state.d))
    steps = [before - after for before, after in itertools.pairwise(depths)]
    assert set(steps[:-1]) == {slew_of(config)}
    assert (i_d, motoring) == (0, Input().current)


def test_field_weakening_is_kept_at_the_voltage_limit(core: Core) -> None:
    """If it were released above the voltage limit, the motor would brake with more than its current limit."""
    weakening = Weakening(core, Config())
    for _ in range(3):
        weakening.step(Input(q=round(14.0 * VOLT)))
    before = int(weakening.state.d)
    for _ in range(100):
        weakening.step(Input(q=round(14.0 * VOLT), emf=round(13.2 * VOLT), enabled=False))
    assert weakening.state.d == before > 0


@given(current=st.integers(200, ONE - 1))
def test_half_of_a_small_current_limit_remains_for_braking(core: Core, current: int) -> None:
    """A current limit below i_d_max, as of a hot winding: half of it remains for braking."""
    weakening = Weakening(core, Config())
    for _ in range(200):
        _, i_q_max, _ = weakening.step(Input(q=round(14.0 * VOLT), current=current))
    assert i_q_max >= 0.47 * current


@given(psi=st.floats(0.9, 1.1), inductance=st.floats(0.9, 1.1), i_q=st.floats(-1.0, 1.0), volts=st.floats(12.4, 13.0))
def test_voltage_settles_at_the_margin(core: Core, psi: float, inductance: float, i_q: float, volts: float) -> None:
    """Steady voltage equations of axis 1 at 4000 rpm in floating point, one tick late, for motors 10 % off."""
    omega, weakening, config = 837.8, Weakening(core, Config()), Config()
    i_d = late = 0.0
    for _ in range(300):
        q = clip16(round(i_q * AMP)) / AMP
        u_d = 0.55 * late - omega * 0.512e-3 * inductance * q
        u_q = 0.55 * q + omega * (0.0154 * psi + 0.403e-3 * inductance * late)
        late = i_d
        given_ = Input(d=clip16(round(u_d * VOLT)), q=clip16(round(u_q * VOLT)), u_max=round(volts * VOLT))
        i_d = weakening.step(given_)[0] / AMP
    free = volts - math.hypot(u_d, u_q)
    if i_d == 0.0:
        assert free >= 0.3 - 0.01
    elif round(i_d * AMP) == -config.i_d_max:
        assert free <= 0.3 + 0.01
    else:
        assert free == pytest.approx(0.3, abs=0.01)
