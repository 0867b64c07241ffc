"""Hysteresis and energy budget of the brake resistor, and the permitted braking current, against arithmetic."""

from __future__ import annotations

from typing import Any

import pytest
from core_library import Core
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_tuning.braking import brake_constants
from tuning_tool import configuration

TICK = 0.5e-3
U_FULL = 36.3


def volts(value: float) -> int:
    return round(value / U_FULL * 2**15)


class Resistor:
    """A resistor of 4.7 ohm, 10 W continuous, 60 J pulse, on at 28 V, off at 27 V."""

    def __init__(self, core: Core, *, fitted: bool = True, **changes: object) -> None:
        self.lib = core.lib
        self.fitted = fitted
        self.config: Any = core.ffi.new("bus_braking_config_t *", brake_constants(configuration(**changes)))
        self.brake: Any = core.ffi.new("bus_braking_t *")
        self.lib.bus_braking_init(self.brake)

    def step(self, u_dc: float, ticks: int = 1) -> bool:
        for _ in range(ticks):
            self.lib.bus_braking_step(self.brake, self.config, self.fitted, volts(u_dc))
        return bool(self.brake.on)

    @property
    def heat(self) -> float:
        """Used part of the budget."""
        return float(self.brake.heat) / 2**31


def test_the_resistor_switches_with_hysteresis(core: Core) -> None:
    resistor = Resistor(core)
    course = [(24.0, False), (27.9, False), (28.1, True), (27.5, True), (27.1, True), (26.9, False), (27.5, False)]
    assert [(u, resistor.step(u)) for u, _ in course] == course


def test_without_a_resistor_nothing_is_switched(core: Core) -> None:
    resistor = Resistor(core, fitted=False)
    assert not resistor.step(32.0, 100)
    assert not resistor.brake.available


def test_the_budget_is_the_energy_of_the_resistor(core: Core) -> None:
    """30 V at 4.7 ohm are 191.5 W, minus 10 W of cooling: 60 J last for 0.33 s."""
    resistor = Resistor(core)
    resistor.step(30.0)
    ticks = 0
    while not resistor.brake.exhausted:
        resistor.step(30.0)
        ticks += 1
        assert ticks < 10_000
    assert ticks * TICK == pytest.approx(60.0 / (30.0**2 / 4.7 - 10.0), rel=2e-3)
    assert not resistor.brake.on
    assert not resistor.brake.available


def test_an_exhausted_resistor_is_off_until_half_of_the_budget_has_recovered(core: Core) -> None:
    """30 J at 10 W: 3 s, independent of the voltage."""
    resistor = Resistor(core)
    resistor.step(35.0, 1500)
    resistor.step(24.0, 20_000)
    resistor.step(30.0)
    while not resistor.brake.exhausted:
        resistor.step(30.0)
    ticks = 0
    while resistor.brake.exhausted:
        assert not resistor.brake.on
        resistor.step(31.0)
        ticks += 1
    assert ticks * TICK == pytest.approx(3.0, rel=1e-3)
    assert resistor.brake.on, "used again"


def test_heat_of_the_resistor_decays_to_zero_and_no_further(core: Core) -> None:
    resistor = Resistor(core)
    resistor.step(29.0, 10)
    assert resistor.heat > 0.0
    resistor.step(24.0, 10_000)
    assert resistor.heat == 0.0


@pytest.mark.parametrize(
    ("u_dc", "part"), [(24.0, 1.0), (29.0, 1.0), (30.0, 2 / 3), (31.5, 1 / 6), (32.0, 0.0), (36.0, 0.0)]
)
def test_braking_current_is_folded_back(core: Core, u_dc: float, part: float) -> None:
    resistor = Resistor(core, fitted=False)
    resistor.step(u_dc, 2)
    assert resistor.brake.regen_derating / 2**15 == pytest.approx(part, abs=1e-3)


def test_a_rising_bus_folds_back_earlier_and_a_falling_one_not_later(core: Core) -> None:
    """The voltage is extrapolated by four ticks."""
    resistor = Resistor(core, fitted=False)
    resistor.step(28.0, 2)
    resistor.step(28.5)
    assert resistor.brake.regen_derating / 2**15 == pytest.approx(0.5, abs=2e-3)  # as at 30.5 V
    resistor.step(28.0)
    assert resistor.brake.regen_derating == 2**15 - 1


@settings(deadline=None, derandomize=True, max_examples=50)
@given(course=st.lists(st.tuples(st.floats(0.0, 36.2), st.integers(1, 400)), min_size=1, max_size=30))
def test_resistor_state_stays_valid_at_any_bus_voltage(core: Core, course: list[tuple[float, int]]) -> None:
    resistor = Resistor(core, board__brake__energy=3.0)
    for u_dc, ticks in course:
        resistor.step(u_dc, ticks)
        brake = resistor.brake
        assert not (brake.on and (brake.exhausted or u_dc < 26.9))
        assert brake.heat >= 0
        assert 0 <= brake.regen_derating <= 2**15 - 1
