"""Analytic motions: from rest to rest, within their limits."""

from __future__ import annotations

import contextlib
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.trajectory.check import Limits, first_violation
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.shapes import lissajous, move, sine, stop

JOINTS = ("axis1", "axis2")


def at_rest(path: Path, time: float) -> bool:
    state = path.state(time)
    return bool(np.abs(state.velocity).max() < 1e-7 and np.abs(state.acceleration).max() < 1e-5)


def test_a_move_takes_the_given_time() -> None:
    path = move(JOINTS, [1.0, 2.0], [4.0, 2.0], 2.0)
    assert (path.start_time, path.end_time) == (0.0, 2.0)
    assert at_rest(path, 0.0)
    assert at_rest(path, 2.0)
    np.testing.assert_array_equal(path.state([0.0, 2.0]).position, [[1.0, 2.0], [4.0, 2.0]])
    # Minimum jerk: highest velocity 15/8 of the mean.
    assert path.state(1.0).velocity[0] == pytest.approx(15 / 8 * 1.5)


@pytest.mark.parametrize(
    "limit",
    [
        Limits(velocity_max=3.0),
        Limits(acceleration_max=20.0),
        Limits(torque_max=0.5, inertia=0.02, viscous=0.01, coulomb=0.05),
        Limits(velocity_max=3.0, acceleration_max=5.0, position_max=0.0),
    ],
)
def test_a_move_is_as_fast_as_the_limits_permit(limit: Limits) -> None:
    path = move(JOINTS, [0.0, 0.0], [3.0, -1.0], limits=[limit, limit])
    free = [replace(limit, position_max=np.inf)] * 2
    assert first_violation(path, free) is None
    assert first_violation(move(JOINTS, [0.0, 0.0], [3.0, -1.0], 0.97 * path.duration), free) is not None


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"duration": 0.0}, "duration is 0 s; write a finite number above 0"),
        ({"duration": float("nan")}, "duration is nan s"),
        ({}, "no duration is given"),
        ({"limits": [Limits(), Limits(velocity_max=1.0)]}, "no duration is given"),
        ({"limits": [Limits(torque_max=1.0, inertia=0.1, coulomb=2.0)] * 2}, "no duration is long enough: torque of"),
    ],
)
def test_invalid_moves_are_refused(arguments: dict[str, Any], sentence: str) -> None:
    with pytest.raises(TrajectoryError, match=sentence):
        move(JOINTS, [0.0, 0.0], [1.0, 1.0], **arguments)


def test_a_move_to_where_the_joints_are_is_short() -> None:
    path = move(JOINTS, [1.0, 1.0], [1.0, 1.0], limits=[Limits(velocity_max=1.0)] * 2)
    assert path.duration <= 0.01
    assert path.state(0.001).position[0] == 1.0


@given(st.integers(0, 1000))
def test_a_stop_begins_with_the_state_and_keeps_its_limit(seed: int) -> None:
    random = np.random.default_rng(seed)
    p, v, a, e = random.uniform(-3.0, 3.0, (4, 2)) * [[1], [20], [50], [1]]
    path = stop(JOINTS, State(p, v, a, e), [100.0, 200.0], 5.0)
    state = path.state(5.0)
    for actual, expected in zip(
        (state.position, state.velocity, state.acceleration, state.effort), (p, v, a, e), strict=True
    ):
        np.testing.assert_allclose(actual, expected)
    assert at_rest(path, path.end_time)
    np.testing.assert_allclose(path.state(path.end_time - 1e-9).position, path.end, atol=1e-9)
    bounds = [Limits(acceleration_max=max(100.0, 1.002 * abs(a[0]))), Limits(acceleration_max=200.0)]
    assert first_violation(path, bounds) is None
    assert path.duration < 3.0 * max(abs(v[0]) / 100.0 + 1.0, abs(v[1]) / 200.0)


def test_a_sine_is_exact_between_its_ramps_and_at_rest_at_its_ends() -> None:
    path = sine("axis1", 1.0, 2.0, 0.5, 10.0)
    t = np.linspace(2.0, 8.0, 5001)
    np.testing.assert_allclose(path.state(t).position[:, 0], 1.0 + 2.0 * np.sin(np.pi * t), atol=2e-8 * 2.0)
    np.testing.assert_allclose(path.state(t).velocity[:, 0], 2.0 * np.pi * np.cos(np.pi * t), atol=1e-5)
    for time in (0.0, 10.0):
        assert at_rest(path, time)
        assert path.state(time).position[0] == pytest.approx(1.0)
    everywhere = np.linspace(0.0, 10.0, 100_001)
    steps = np.abs(np.diff(path.state(everywhere).acceleration[:, 0]))
    assert steps.max() < 1.2e-4 * 2.0 * 60.0  # jerk of the ramps: no step of the acceleration


def test_a_lissajous_figure_with_one_frequency_is_a_circle() -> None:
    path = lissajous(JOINTS, [1.0, -1.0], [0.5, 0.5], [2.0, 2.0], 4.0, ramp=0.3)
    t = np.linspace(0.3, 3.7, 3001)
    radius = np.hypot(*(path.state(t).position - [1.0, -1.0]).T)
    np.testing.assert_allclose(radius, 0.5, atol=1e-7)
    assert at_rest(path, 0.0)
    assert at_rest(path, 4.0)
    assert first_violation(path, [Limits(position_max=1.4)] * 2) is not None


def test_frequencies_of_a_lissajous_figure_may_differ() -> None:
    path = lissajous(JOINTS, [0.0, 0.0], [1.0, 2.0], [3.0, 2.0], 4.0, phase=0.0)
    t = np.linspace(0.5, 3.5, 3001)
    expected = np.stack((np.sin(6.0 * np.pi * t), 2.0 * np.sin(4.0 * np.pi * t)), axis=-1)
    np.testing.assert_allclose(path.state(t).position, expected, atol=1e-7)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((0.0, 1.0, -1.0, 1.0), "frequency is -1 Hz"),
        ((0.0, 1.0, 1.0, np.inf), "duration is inf s"),
        ((0.0, 1.0, 1.0, 1.0, 0.6), "two ramps of 0.6 s do not fit into 1 s"),
        ((np.nan, 1.0, 1.0, 1.0), "positions of axis1 at point #0 is nan"),
    ],
)
def test_invalid_sines_are_refused(arguments: Any, sentence: str) -> None:
    with pytest.raises(TrajectoryError, match=sentence):
        sine("axis1", *arguments)


def test_a_lissajous_figure_needs_two_joints() -> None:
    with pytest.raises(TrajectoryError, match="two joints"):
        lissajous(["axis1"], [0.0], [1.0], [1.0], 1.0)


HUGE = st.floats(1e-12, 1e308)


@pytest.mark.filterwarnings("error")
@given(HUGE, HUGE, HUGE)
def test_a_sine_of_any_numbers_is_planned_or_refused(amplitude: float, frequency: float, duration: float) -> None:
    """Bounds come before the work: no memory for the points of a path that is refused, no overflow."""
    with contextlib.suppress(TrajectoryError):
        sine("axis1", 0.0, amplitude, frequency, duration)


@pytest.mark.filterwarnings("error")
@given(HUGE, st.none() | HUGE)
def test_a_move_of_any_numbers_is_planned_or_refused(goal: float, duration: float | None) -> None:
    with contextlib.suppress(TrajectoryError):
        move(["axis1"], [0.0], [goal], duration, [Limits(velocity_max=300.0, acceleration_max=4000.0)])


def test_a_ramp_that_is_too_short_for_its_points_is_named() -> None:
    with pytest.raises(TrajectoryError, match="use a ramp of at least") as caught:
        sine("axis1", 0.0, 1.0, 1.0, 60.0, ramp=1e-3)
    (ramp,) = re.findall(r"at least ([\d.e-]+) s", str(caught.value))
    sine("axis1", 0.0, 1.0, 1.0, 60.0, ramp=float(ramp))


@pytest.mark.parametrize(("frequency", "duration"), [(1e4, 1e5), (4200.0, 1.0), (1.0, 5000.0), (100.0, 41.7)])
def test_values_that_the_refusal_of_a_sine_names_are_accepted(frequency: float, duration: float) -> None:
    with pytest.raises(TrajectoryError, match="waypoints, more than 100000") as caught:
        sine("axis1", 0.0, 1.0, frequency, duration)
    lower, shorter = map(float, re.findall(r"([\d.e+-]+) (?:Hz, or|s$)", str(caught.value)))
    sine("axis1", 0.0, 1.0, lower, duration)
    sine("axis1", 0.0, 1.0, frequency, shorter)
