"""The thermal model of a winding in integers, compared with the same heat balance in floating point."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from diagnosis_rig import Diagnosis
from firmware_compiler import CompileC
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_msgs_py.axis_config import AxisConfigTable
from servo_tuning.configuration import Axis
from servo_tuning.errors import ConfigError
from servo_tuning.tuned import tuned
from servo_tuning.winding import COLD, COPPER, FULL, STEP_TICKS, Winding
from tuning_tool import configuration

STEP = STEP_TICKS * 0.5e-3  # s
LSB = FULL / 2**15  # LSB of the published temperature [K]
AMPERE = 2**15 / 8.25
MEMBERS = {name: member for name, member in AxisConfigTable.load().members.items() if name.startswith("winding_model.")}
GROUP = "winding_model."


@pytest.fixture(scope="module")
def rig(compile_c: CompileC) -> Diagnosis:
    return Diagnosis(compile_c)


def axis(**changes: float) -> Axis:
    """The first axis with other entries of [winding] and, by ``motor__``, of [motor]."""
    names = {key if "__" in key else f"winding__{key}": value for key, value in changes.items()}
    return configuration(**{f"axis1__{key}": value for key, value in names.items()}).axes[0]


class Model:
    """Winding model of the firmware for one axis."""

    def __init__(self, rig: Diagnosis, block: dict[str, int]) -> None:
        self._lib = rig.lib
        members = {key.removeprefix(GROUP): block[key] for key in MEMBERS}
        self.config: Any = rig.ffi.new("winding_model_config_t *", members)
        self.state: Any = rig.ffi.new("winding_model_t *")
        self._lib.winding_model_init(self.state, self.config)

    @classmethod
    def of(cls, rig: Diagnosis, it: Axis) -> Model:
        return cls(rig, tuned(it, configuration()).block)

    @property
    def celsius(self) -> float:
        return float(self.state.temperature) / 2**31 * FULL

    @celsius.setter
    def celsius(self, value: float) -> None:
        self.state.temperature = round(value / FULL * 2**31)

    def steps(self, i_d: float, i_q: float, count: int = 1, *, supervised: bool = True) -> None:
        """Run `count` steps with this current [A]."""
        current = (round(i_d * AMPERE), round(i_q * AMPERE))
        for _ in range(count):
            due = [self._lib.winding_model_add(self.state, current) for _ in range(STEP_TICKS)]
            assert due == [False] * (STEP_TICKS - 1) + [True]
            self._lib.winding_model_step(self.state, self.config, supervised)

    def step_steadily(self, i_q: float) -> None:
        """Run a step with the sum of its ticks at a constant current [A]; faster than single ticks."""
        self.state.squares = round(i_q * AMPERE) ** 2 // STEP_TICKS * STEP_TICKS
        self._lib.winding_model_step(self.state, self.config, True)

    def limit(self, maximum: float = 4.0) -> float:
        """Derated current limit [A]."""
        winding = self._lib.winding_model_limit(self.state, self.config, round(maximum * AMPERE))
        return min(float(winding) / AMPERE, maximum)


def exact(it: Winding, begin: float, current: float, seconds: float) -> float:
    """Solution of the heat balance for a constant current [deg C]."""
    loss = it.loss(current, COLD)
    rate = (1.0 / it.resistance - COPPER * loss) / it.capacity
    slope = (it.loss(current, begin) - (begin - it.ambient) / it.resistance) / it.capacity
    return begin + (slope * seconds if rate == 0.0 else -slope * math.expm1(-rate * seconds) / rate)


# ---- the heat balance
@settings(max_examples=60)
@given(
    r_s=st.floats(0.1, 3.0),
    rated=st.floats(0.7, 4.0),
    capacity=st.floats(3.0, 300.0),
    begin=st.floats(20.0, 120.0),
    i_d=st.floats(-3.0, 3.0),
    i_q=st.floats(-4.0, 4.0),
    steps=st.integers(1, 600),
)
def test_integers_follow_the_heat_balance(
    rig: Diagnosis, r_s: float, rated: float, capacity: float, begin: float, i_d: float, i_q: float, steps: int
) -> None:
    it = axis(motor__r_s=r_s, motor__rated_current=rated, heat_capacity=capacity)
    nominal = Winding.of(it)
    end = exact(nominal, begin, math.hypot(i_d, i_q), steps * STEP)
    if end > 250.0 or nominal.resistance * capacity < 20.0:
        return  # a winding that saturates, and one with a shorter time constant than any motor
    model = Model.of(rig, it)
    model.celsius = begin
    model.steps(i_d, i_q, steps)
    # a step of 32 ms uses the losses of its start; the integers of a very slow winding are coarse
    change = abs(end - begin) + abs(begin - nominal.ambient) * 0.02
    assert model.celsius == pytest.approx(end, abs=0.05 + 0.02 * change)


def test_the_rated_current_leads_to_the_maximum_temperature(rig: Diagnosis) -> None:
    model = Model.of(rig, axis(heat_capacity=1.0))
    model.celsius = 40.0
    model.steps(0.0, 2.0, round(300.0 / STEP))
    assert model.celsius == pytest.approx(130.0, abs=0.2)
    assert not model.state.hot


@pytest.mark.parametrize(("i_d", "i_q"), [(0.0, 4.0), (-4.0, 0.0), (2.4, -3.2)])
def test_heating_depends_on_the_amplitude_of_the_current_vector_only(rig: Diagnosis, i_d: float, i_q: float) -> None:
    model = Model.of(rig, axis())
    model.steps(i_d, i_q, 100)
    assert model.celsius == pytest.approx(exact(Winding.of(axis()), 100.0, 4.0, 100 * STEP), abs=0.01)


def test_winding_cools_down_to_the_temperature_of_its_surroundings(rig: Diagnosis) -> None:
    model = Model.of(rig, axis(heat_capacity=1.0, thermal_resistance=19.0))
    model.steps(0.0, 0.0, round(300.0 / STEP))
    assert model.celsius == pytest.approx(40.0, abs=LSB)


@settings(max_examples=60)
@given(data=st.data())
def test_any_accepted_configuration_stays_within_the_formats(rig: Diagnosis, data: st.DataObject) -> None:
    """All members within their ranges, any current and temperature: no overflow, and the limit is never exceeded."""
    block = {path: data.draw(st.integers(*m.raw_range), path) for path, m in MEMBERS.items()}
    model = Model(rig, block)
    raw = st.integers(-(2**15), 2**15 - 1)
    lowest = min(block[GROUP + "ambient"], block[GROUP + "initial"])
    for _ in range(4):
        current = data.draw(raw), data.draw(raw)
        model.steps(current[0] / AMPERE, current[1] / AMPERE)
        raised = (model.state.temperature >> 16) - lowest
        assert raised >= -1, "no wrap by heating or cooling"
        maximum = data.draw(st.integers(0, 2**15 - 1))
        limit = model._lib.winding_model_limit(model.state, model.config, maximum)
        assert min(maximum, block[GROUP + "rated_current"]) <= limit <= 2**15 - 1
        assert limit <= maximum or limit == 2**15 - 1


def test_the_largest_losses_saturate(rig: Diagnosis) -> None:
    """At the ends of the ranges, with sanitizers: the temperature saturates at the end of its format."""
    block = {path: m.raw_range[1] for path, m in MEMBERS.items()} | {
        GROUP + "ambient": -12800,
        GROUP + "initial": 32767,
    }
    model = Model(rig, block)
    model.steps(-8.25, -8.25, 3)
    assert model.state.temperature > 2**31 - 2**30
    block |= {GROUP + "cooling": 1}
    model = Model(rig, block)
    model.steps(-8.25, -8.25, 3)
    assert model.state.temperature == 2**31 - 1


# ---- the limit
def test_the_limit_falls_from_the_derating_to_the_rated_current_at_the_maximum(rig: Diagnosis) -> None:
    model = Model.of(rig, axis())
    for celsius, limit in ((-20.0, 4.0), (100.0, 4.0), (115.0, 3.0), (122.5, 2.5), (130.0, 2.0), (200.0, 2.0)):
        model.celsius = celsius
        assert model.limit() == pytest.approx(limit, abs=2.0 / 30.0 * LSB + 1.0 / AMPERE)
    assert model.limit(1.5) == pytest.approx(1.5, abs=1.0 / AMPERE)
    model.celsius = 115.0
    assert model.limit(8.0) == pytest.approx(
        5.0, abs=0.01
    )  # a host limit above the motor's current limit is derated too


def test_full_current_demand_ends_at_the_maximum_temperature_without_a_fault(rig: Diagnosis) -> None:
    model = Model.of(rig, axis(heat_capacity=1.0))
    highest = 0.0
    for _ in range(round(120.0 / STEP)):
        model.steps(0.0, model.limit())
        highest = max(highest, model.celsius)
        assert not model.state.hot
    assert model.limit() == pytest.approx(2.0, abs=0.02)
    assert 129.0 < model.celsius <= highest < 130.1


@settings(max_examples=25)
@given(
    r_s=st.floats(0.1, 3.0),
    rated=st.floats(0.7, 3.9),
    capacity=st.floats(0.5, 40.0),
    ambient=st.integers(-20, 80),
    begin=st.floats(20.0, 130.0),
)
def test_any_motor_settles_between_derating_and_maximum_temperature(
    rig: Diagnosis, r_s: float, rated: float, capacity: float, ambient: int, begin: float
) -> None:
    """From any start temperature with the full current demand, without a fault."""
    it = axis(motor__r_s=r_s, motor__rated_current=rated, heat_capacity=capacity, ambient=ambient)
    nominal = Winding.of(it)
    heats = nominal.loss(4.0, 130.0) * STEP / capacity
    if heats > 5.0 or nominal.resistance * capacity > 60.0:
        return  # skipped: few steps from derating to fault, or too long for this test
    model = Model.of(rig, it)
    model.celsius = begin
    for _ in range(round(8.0 * nominal.resistance * capacity / STEP)):
        model.step_steadily(model.limit())
        assert not model.state.hot
        assert model.celsius < 130.0 + heats + 0.1
    current, end = nominal.settled()
    assert model.celsius == pytest.approx(end, abs=1.0)
    assert model.limit() == pytest.approx(current, abs=0.05 * (4.0 - rated) + 0.03)


# ---- the fault
def test_motor_temperature_fault_needs_its_feature_and_can_be_cleared_below_the_maximum(rig: Diagnosis) -> None:
    model = Model.of(rig, axis())
    model.celsius = 139.5
    model.steps(0.0, 0.0)
    assert not model.state.hot
    model.celsius = 140.5
    model.steps(0.0, 0.0, supervised=False)
    assert not model.state.hot
    model.steps(0.0, 0.0)
    assert model.state.hot
    model.celsius = 130.5
    model.steps(0.0, 0.0)
    assert model.state.hot
    model.celsius = 129.9
    model.steps(0.0, 0.0)
    assert not model.state.hot


# ---- report of the tuning code
def test_the_figures_of_the_report_agree_with_the_heat_balance() -> None:
    it = replace(Winding.of(axis()), ambient=25.0)
    assert it.equilibrium(0.0) == 25.0
    for current in (1.0, 2.0, 2.5):
        end = it.equilibrium(current)
        assert it.loss(current, end) == pytest.approx((end - 25.0) / it.resistance)
    assert math.isinf(it.equilibrium(4.0))  # it heats up faster than its surroundings
    assert it.time_to(10.0, 1.0) == 0.0
    assert math.isinf(it.time_to(it.equilibrium(2.0) + 1.0, 2.0))
    for current in (2.0, 4.0):
        assert exact(it, 25.0, current, it.time_to(60.0, current)) == pytest.approx(60.0)
    current, end = it.settled()
    assert it.limit(end) == pytest.approx(current)
    assert it.loss(current, end) == pytest.approx((end - 25.0) / it.resistance, rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "name", "reason"),
    [
        ({"ambient": 100.0}, r"axis1\.winding\.ambient = 100", "not below winding.derating"),
        ({"derating": 130.0}, r"axis1\.winding\.derating = 130", "not below winding.maximum"),
        ({"maximum": 145.0}, r"axis1\.winding\.maximum = 145", "not below winding.fault"),
        ({"initial": 131.0}, r"axis1\.winding\.initial = 131", "above winding.maximum"),
        ({"fault": 300.0}, r"axis1\.winding\.fault = 300", "does not fit"),
        ({"thermal_resistance": 25.0}, r"axis1\.motor\.rated_current = 2", "continuously it heats the winding to"),
        ({"heat_capacity": 1e-4}, "heating of the winding", "does not fit"),
        ({"heat_capacity": 1e12}, "heating of the winding", "would vanish"),
    ],
)
def test_invalid_winding_entries_are_refused(changes: dict[str, float], name: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=name) as refusal:
        tuned(axis(**changes), configuration())
    assert reason in str(refusal.value)
