"""The sensorless experiments: the drive agrees with the bounds; wrong settings violate them."""

from __future__ import annotations

import dataclasses
import math
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_twin.plant import PlantConfig
from servo_twin.runner import HERE
from servo_twin.validation.experiments import minimum_speed, observer, sensorless_load_step, sensorless_stall, start_up
from servo_twin.validation.experiments.outcome import Outcome
from servo_twin.validation.experiments.sensorless import degrees
from servo_twin.validation.experiments.sensorless_stall import variance_detection_time
from servo_twin.validation.experiments.start_up import CRITERION_MAX, draws, examine, many

PLANT = PlantConfig.load()
SEED = 4


def run(module: ModuleType) -> Outcome:
    outcome: Outcome = module.run(PLANT, SEED)
    return outcome


def wrong(outcome: Outcome) -> list[str]:
    """Figures that do not agree."""
    return [row.name for row in outcome.rows if not row.agrees]


def trace(speed: NDArray[np.float64], **arrays: Any) -> Trace:
    """A trace with the given observed speed; all other signals are zero."""
    still = {name: np.zeros(speed.size) for name in ("theta_e", "omega", "angle", "substate", "faults")}
    return Trace(TICK, still | {"speed": speed} | arrays, first=1)


def test_angles_are_compared_within_half_a_turn() -> None:
    assert degrees(np.array([math.radians(350.0), math.radians(-190.0)])) == pytest.approx([-10.0, 170.0])


# ---- observer -------------------------------------------------------------------------------------------------------


@pytest.fixture
def short_observer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(observer, "SPEEDS", (1.0 / 15.0, 1.0 / 3.0))
    monkeypatch.setattr(observer, "CURRENTS", (0.0, 0.5))
    monkeypatch.setattr(observer, "SENSITIVE", (1.0 / 3.0,))
    monkeypatch.setattr(observer, "WINDINGS", ((1.5, 1.0), (1.0, 0.5)))


def test_observer_agrees_with_the_reference_design(short_observer: None) -> None:
    assert wrong(run(observer)) == []


def test_angle_error_by_calculation() -> None:
    motor = PLANT.axes[0]
    other = dataclasses.replace(motor, l_q=2.0 * motor.l_q)
    expected = math.degrees(math.atan2((2.0 * 0.512e-3 - 0.4575e-3) * 2.0, 0.0154))
    assert observer.theoretical_error(other, motor, 100.0, 2.0) == pytest.approx(expected, rel=1e-6)
    hot = dataclasses.replace(motor, r_s=2.0 * motor.r_s)
    assert (
        0.0 < observer.theoretical_error(hot, motor, 100.0, 2.0) < observer.theoretical_error(motor, motor, 100.0, 2.0)
    )


# ---- start-up -------------------------------------------------------------------------------------------------------


def test_start_up_agrees(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start_up, "STARTS", 6)
    outcome = run(start_up)
    assert wrong(outcome) == []
    assert outcome.row("successful random starts").measured == 100.0


def test_start_up_of_a_blocked_shaft_does_not_agree() -> None:
    stuck = PLANT
    for axis in range(2):
        stuck = stuck.with_axis(axis, friction=10.0)
    starts = many(stuck, SEED, 2, HERE)
    assert [start.end for start in starts] == ["START_UP", "START_UP"]
    assert not any(start.succeeded for start in starts)


def test_random_starts_are_determined_by_the_seed() -> None:
    assert draws(1, 3) == draws(1, 5)[:3]
    assert draws(1, 3) != draws(2, 3)
    for draw in (draw for board in draws(1, 200) for draw in board):
        assert 0.5 <= draw.inertia <= 2.0
        assert 0.15 <= abs(draw.set_point) <= 0.9


def test_times_are_relative_to_the_start_up() -> None:
    substates = np.array([1] * 10 + [5] * 100 + [3] * 50)
    angle = np.where(np.arange(160) < 70, 1.0, 0.1)
    found = examine(trace(np.zeros(160), substate=substates, angle=angle), 5, 3)
    assert found.criterion is not None
    assert found.criterion == pytest.approx(100 * TICK)
    assert found.converged == pytest.approx(60 * TICK)
    assert found.criterion < CRITERION_MAX
    never = examine(trace(np.zeros(160), substate=substates, angle=np.full(160, 2.0)), 5, 3)
    assert never.converged is None
    assert examine(trace(np.zeros(160), substate=np.where(substates == 3, 5, substates)), 5, 3).end == "no closed loop"


# ---- minimum speed --------------------------------------------------------------------------------------------------


def test_minimum_speed_agrees(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(minimum_speed, "LOADS", (0.25,))
    monkeypatch.setattr(minimum_speed, "STEPS", (0.3, 0.08, 0.05, 0.02))
    outcome = run(minimum_speed)
    assert wrong(outcome) == []
    assert outcome.row("axis1, load 25 %, lowest speed").measured == pytest.approx(5.0)


# ---- load step ------------------------------------------------------------------------------------------------------


def test_load_step_agrees(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensorless_load_step, "SPEEDS", (0.05, 0.2))
    monkeypatch.setattr(sensorless_load_step, "STEPS", (0.2, 0.4, 0.5))
    assert wrong(run(sensorless_load_step)) == []


def test_too_large_load_step_is_detected() -> None:
    """The second step exceeds the torque of the current limit, so the shaft reverses; the first step is the result."""
    it = sensorless_load_step.largest_step(PLANT, SEED, 0, 0.1, (0.3, 1.2))
    assert it.torque == pytest.approx(0.3 * 4.0 * PLANT.axes[0].torque_constant, rel=1e-3)
    assert it.end


# ---- stall ----------------------------------------------------------------------------------------------------------


def test_variance_detects_noise_and_accepts_a_steady_speed() -> None:
    noise = np.random.default_rng(1).normal(0.0, 30.0, 3000)
    detected = variance_detection_time(trace(noise), 0.0)
    assert detected is not None
    assert detected == pytest.approx((sensorless_stall.SIZE + sensorless_stall.HYSTERESIS) * TICK, rel=0.1)
    assert variance_detection_time(trace(np.full(3000, 20.0)), 0.0) is None
    slow = 20.0 + 4.0 * np.sin(2.0 * np.pi * 4.0 * TICK * np.arange(3000))
    assert variance_detection_time(trace(slow), 0.0) is None, (
        "not detectable by the variance criterion of the reference design"
    )


def test_stall_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensorless_stall, "SPEEDS", (0.2, 0.8))
    monkeypatch.setattr(sensorless_stall, "FREQUENCIES", (4.0,))
    monkeypatch.setattr(sensorless_stall, "LONG", 2.0)
    assert wrong(run(sensorless_stall)) == []
