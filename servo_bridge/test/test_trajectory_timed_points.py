"""Timed points: close to the path between them, at PWM periods, without drift."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.timed_points import TOLERANCE, TimedPoints, timed_points
from servo_bridge.trajectory.waypoints import Waypoints
from servo_msgs_py.units import PERIOD


def random_path(seed: int, scale: float = 1.0) -> Path:
    """Random path of two joints from a random state through five waypoints, half of them with accelerations."""
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.05, 1.0, 5))
    rows = scale * random.uniform(-3.0, 3.0, (3, 5, 2))
    half = [row if k < 3 else None for k, row in enumerate(rows[2])]
    p, v, a = scale * random.uniform(-1.0, 1.0, (3, 2))
    start = State(p, v, a, np.zeros(2))
    return path_through(Waypoints.of(["axis1", "axis2"], times, rows[0], rows[1], half), start)


def deviation(path: Path, axis: int, points: TimedPoints) -> float:
    t = np.linspace(max(points.periods[0] * PERIOD, path.start_time), points.periods[-1] * PERIOD, 20_001)
    return float(np.abs(points.interpolated(t) - path.continued(t).position[:, axis]).max())


@given(st.integers(0, 10_000), st.floats(-2.0, 1.0), st.sampled_from([TOLERANCE, 1e-2]))
def test_the_board_stays_near_the_path(seed: int, exponent: float, tolerance: float) -> None:
    path = random_path(seed, 10.0**exponent)
    for axis, points in enumerate(timed_points(path, tolerance).values()):
        assert deviation(path, axis, points) <= tolerance
        assert np.diff(points.periods).min() >= 16


def test_acceleration_step_between_periods_is_not_shifted() -> None:
    # A cubic of 1 s from rest to rest and a hold; the breakpoints are between two periods.
    for shift in (0.0, 0.00002, 0.00004):
        times = [0.0, 1.0 + shift, 2.0 + shift, 3.0 + shift]
        path = path_through(Waypoints.of(["axis1"], times, [[0], [0], [300.0], [300.0]], [[0]] * 4))
        points = timed_points(path)["axis1"]
        assert deviation(path, 0, points) <= TOLERANCE
        assert len(points.periods) == (4 if not shift else 6)


def test_number_of_points_is_near_the_minimum() -> None:
    quintic = path_through(Waypoints.of(["axis1"], [0, 1], [[0], [6.28]]), None)
    assert len(timed_points(quintic)["axis1"].periods) == 2  # positions alone: a cubic
    quintic = path_through(Waypoints.of(["axis1"], [1], [[6.28]]), State.at_rest([0.0]))
    points = timed_points(quintic)["axis1"]
    assert TOLERANCE / 20 < deviation(quintic, 0, points) <= TOLERANCE
    assert len(points.periods) <= 14


@given(st.integers(0, 10_000))
def test_points_lie_on_the_path_at_rounded_times(seed: int) -> None:
    path = random_path(seed)
    for axis, points in enumerate(timed_points(path).values()):
        state = path.continued(points.periods * PERIOD)
        np.testing.assert_allclose(points.positions, state.position[:, axis], atol=1e-12)
        np.testing.assert_allclose(points.velocities, state.velocity[:, axis], atol=1e-12)
        rounded = np.rint(path.times / PERIOD)
        assert np.isin(rounded, points.periods).all()


def test_last_point_is_exact() -> None:
    path = path_through(Waypoints.of(["axis1"], [1.00002], [[6.28]]), State.at_rest([0.0]))
    points = timed_points(path)["axis1"]
    assert (points.positions[-1], points.velocities[-1]) == (6.28, 0.0)
    moving = path_through(Waypoints.of(["axis1"], [0, 1.00002], [[0], [6.28]], [[0], [400.0]]))
    last = timed_points(moving)["axis1"]
    assert last.velocities[-1] == pytest.approx(400.0, abs=0.1)
    assert last.positions[-1] == pytest.approx(6.28 - 400.0 * 0.00002, abs=1e-6)


def test_an_hour_of_points_does_not_drift() -> None:
    # 3.33 ms, not a multiple of a period
    times = np.arange(1, 1_080_001, 50) / 300.0
    path = path_through(Waypoints.of(["axis1"], times, np.sin(times)[:, None]))
    points = timed_points(path)["axis1"]
    assert points.periods[-1] * PERIOD == pytest.approx(times[-1], abs=0.51 * PERIOD)
    assert np.abs(points.periods * PERIOD - times).max() <= 0.501 * PERIOD


def test_a_long_hold_has_a_point_every_minute() -> None:
    periods = timed_points(Path.hold(["axis1"], [1.0], 0.0, 150.0))["axis1"].periods
    assert len(periods) == 4
    assert np.diff(periods).max() <= 960_000


def test_a_joint_at_rest_needs_two_points() -> None:
    start = State.at_rest([0.0, 1.0])
    path = path_through(Waypoints.of(["axis1", "axis2"], [1], [[6.28, 1.0]]), start)
    assert len(timed_points(path)["axis2"].periods) == 2


def test_breakpoints_closer_than_the_minimum_distance_are_merged_or_refused() -> None:
    fine = np.arange(0.0, 0.1, 0.0004)
    smooth = path_through(Waypoints.of(["axis1"], fine, np.sin(fine)[:, None], np.cos(fine)[:, None]))
    points = timed_points(smooth)["axis1"]
    assert np.diff(points.periods).min() >= 16
    assert deviation(smooth, 0, points) < 1e-6
    sharp = path_through(Waypoints.of(["axis1"], fine, np.where(np.arange(len(fine)) % 2, 0.01, 0.0)[:, None]))
    with pytest.raises(TrajectoryError, match=r"axis1 changes too sharply at 0\.\d+ s: .*; use more time"):
        timed_points(sharp)
    with pytest.raises(TrajectoryError, match="shorter than 1 ms"):
        timed_points(Path.hold(["axis1"], [0.0], 0.0, 0.0005))


def test_effort_is_copied_to_points() -> None:
    path = path_through(Waypoints.of(["axis1"], [0, 1], [[0], [1]], efforts=[[0.1], [0.3]]))
    np.testing.assert_allclose(timed_points(path)["axis1"].efforts, [0.1, 0.3])
    assert math.isclose(TOLERANCE, 0.2 * 2 * math.pi / 4000)
