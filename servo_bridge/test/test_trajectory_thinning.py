"""Fewer points for a path, and whether a line carries them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.trajectory.check import Limits, first_violation
from servo_bridge.trajectory.line_capacity import QUEUE, PointLine, demand, point_line
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.spline import cubic, path_through
from servo_bridge.trajectory.thinning import MERGED_MAX, thinned
from servo_bridge.trajectory.timed_points import TOLERANCE, TimedPoints, timed_points
from servo_bridge.trajectory.waypoints import Waypoints
from servo_msgs_py.units import PERIOD

JOINTS = ["axis1", "axis2"]
RATIOS = {"axis1": 1.0, "axis2": 5.0}


def recorded(rate: float, seconds: float, noise: float = 0.0, seed: int = 0) -> Path:
    """Smooth path of both joints, recorded at a rate [1/s], with noise [rad]."""
    t = np.arange(1, round(rate * seconds) + 1) / rate
    rows = np.stack((1.0 - np.cos(t), np.sin(t) - t), axis=1)
    rows += noise * np.random.default_rng(seed).standard_normal(rows.shape)
    return path_through(Waypoints.of(JOINTS, t, rows), State.at_rest([0.0, 0.0]))


def followed(points: TimedPoints) -> Path:
    """The motion of the board along points."""
    times = points.periods * PERIOD
    p, v = points.positions, points.velocities
    return Path(["axis1"], times, cubic(np.diff(times), p[:-1], v[:-1], p[1:], v[1:])[:, None], p[-1:])


@given(
    rate=st.sampled_from([20.0, 50.0, 125.0, 250.0]), noise=st.sampled_from([0.0, 1e-5, 1e-3]), seed=st.integers(0, 9)
)
def test_thinned_points_follow_the_path_within_the_tolerance(rate: float, noise: float, seed: int) -> None:
    path = recorded(rate, 4.0, noise, seed)
    full = timed_points(path, gear_ratios=list(RATIOS.values()))
    t = np.linspace(path.start_time, path.end_time, 20_000)
    for axis, (joint, points) in enumerate(thinned(path, full, RATIOS).items()):
        assert set(points.periods) <= set(full[joint].periods)
        assert (points.periods[0], points.periods[-1]) == (full[joint].periods[0], full[joint].periods[-1])
        deviation = np.abs(points.interpolated(t) - path.continued(t).position[:, axis]).max()
        assert deviation <= 1.01 * TOLERANCE / RATIOS[joint]
        before, after = (np.abs(followed(each).continued(t).acceleration).max() for each in (full[joint], points))
        assert after <= 1.001 * max(before, np.abs(path.continued(t).acceleration[:, axis]).max())
        assert np.diff(points.periods).max() <= max(MERGED_MAX, np.diff(full[joint].periods).max())


@pytest.mark.parametrize("rate", [50.0, 125.0, 250.0, 500.0])
def test_smooth_path_needs_few_points_at_any_rate_of_its_waypoints(rate: float) -> None:
    path = recorded(rate, 10.0)
    for points in thinned(path, timed_points(path), dict.fromkeys(JOINTS, 1.0)).values():
        assert len(points.periods) < 80


def test_path_within_its_limits_is_so_after_thinning() -> None:
    path = recorded(250.0, 6.0)
    t = np.linspace(path.start_time, path.end_time, 20_000)
    peak = np.abs(path.continued(t).acceleration[:, 0]).max()
    points = thinned(path, timed_points(path), dict.fromkeys(JOINTS, 1.0))["axis1"]
    assert first_violation(followed(points), [Limits(acceleration_max=1.001 * peak)]) is None


def test_feed_forward_of_effort_is_kept() -> None:
    t = np.arange(1, 401) / 100.0
    efforts = np.where(t < 2.0, 0.1, 0.3)[:, None]
    path = path_through(Waypoints.of(["axis1"], t, np.zeros((400, 1)), efforts=efforts), State.at_rest([0.0]))
    points = thinned(path, timed_points(path), {"axis1": 1.0})["axis1"]
    at = np.array([1.0, 1.9, 2.1, 3.0])
    found = np.interp(at, points.periods * PERIOD, points.efforts)
    np.testing.assert_allclose(found, np.interp(at, path.times, path.efforts[:, 0]), atol=0.01)


def evenly(rate: float, count: int, first: float = 0.0) -> np.ndarray:
    """Ticks of points at a rate [1/s] from a time [s] on."""
    return np.rint((first + np.arange(count) / rate) / PERIOD).astype(np.int64)


LINE = PointLine(0.04, "a test")  # 200 points/s


@pytest.mark.parametrize(("rate", "possible"), [(50.0, True), (95.0, True), (105.0, False), (250.0, False)])
def test_line_carries_points_up_to_its_rate(rate: float, possible: bool) -> None:
    need = demand([evenly(rate, 1000), evenly(rate, 1000)], LINE)
    assert math.isfinite(need.lead) is possible
    assert need.rate == pytest.approx(2.0 * rate, abs=2.0)
    alone = demand([evenly(rate, 1000)], LINE)
    assert math.isfinite(alone.lead) is (rate < LINE.rate)


def test_burst_that_fits_the_queue_of_the_board_is_carried_by_any_line() -> None:
    slow = PointLine(0.4, "a test")
    short = demand([evenly(500.0, QUEUE)], slow)
    assert math.isfinite(short.lead)
    assert 0.4 < short.lead < 1.5
    late = np.concatenate((evenly(2.0, 10), evenly(500.0, QUEUE + 10, first=5.0)))
    assert not math.isfinite(demand([late], slow).lead)
    assert demand([late], slow).time == pytest.approx(5.0, abs=0.6)


def test_rate_of_a_line_grows_with_its_speed() -> None:
    rates = [point_line(baud, 80, 0.001).rate for baud in (19_200, 115_200, 1_000_000)]
    assert rates == sorted(rates)
    assert rates[0] < 80.0
    assert point_line(115_200, 80, 0.02).rate < rates[1]
