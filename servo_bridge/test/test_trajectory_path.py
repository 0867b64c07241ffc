"""Paths through waypoints: exact at the waypoints, continuous as specified, joined without a step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.trajectory.blend import joined, spliced
from servo_bridge.trajectory.errors import ErrorCode, TrajectoryError
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.waypoints import Array, Waypoints

JOINTS = ("axis1", "axis2")


def near(actual: Array, desired: Array) -> None:
    np.testing.assert_allclose(actual, desired, rtol=1e-9, atol=1e-7)


gaps = st.lists(st.floats(0.01, 3.0), min_size=1, max_size=8)


def points(steps: list[float], seed: int, *, velocities: bool = False, accelerations: bool = False) -> Waypoints:
    """Random waypoints of both joints after 1 s."""
    random = np.random.default_rng(seed)
    times = 1.0 + np.concatenate(([0.0], np.cumsum(steps)))
    rows = [random.uniform(-5.0, 5.0, (len(times), 2)) for _ in range(4)]
    return Waypoints.of(
        JOINTS, times, rows[0], rows[1] if velocities else None, rows[2] if accelerations else None, rows[3]
    )


def start(seed: int) -> State:
    return State(*np.random.default_rng(seed).uniform(-3.0, 3.0, (4, 2)))


def before(path: Path, time: float) -> State:
    """State just before a breakpoint, from the piece that ends there."""
    k = int(np.searchsorted(path.times, time)) - 1
    piece = Path(path.joints, path.times[k : k + 2], path.coefficients[k : k + 1], path.end)
    return piece.continued(np.nextafter(time, -np.inf))


def same(a: State, b: State) -> None:
    near(a.position, b.position)
    near(a.velocity, b.velocity)
    np.testing.assert_allclose(a.acceleration, b.acceleration, rtol=1e-7, atol=1e-5)


@given(gaps, st.integers(0, 1000), st.booleans(), st.booleans())
def test_a_path_is_exact_at_its_waypoints(steps: list[float], seed: int, fast: bool, quintic: bool) -> None:
    waypoints = points(steps, seed, velocities=fast or quintic, accelerations=quintic)
    path = path_through(waypoints)
    state = path.state(waypoints.times)
    assert (state.position == waypoints.positions).all()
    np.testing.assert_allclose(state.effort, waypoints.efforts)
    if fast or quintic:
        near(state.velocity, waypoints.velocities)
    else:
        np.testing.assert_allclose(state.velocity[[0, -1]], 0.0, atol=1e-9)
    if quintic:
        np.testing.assert_allclose(state.acceleration, waypoints.accelerations, rtol=1e-6, atol=1e-4)
    for time in path.times[1:]:
        near(before(path, time).position, path.state(time).position)
        near(before(path, time).velocity, path.state(time).velocity)


@given(gaps, st.integers(0, 1000), st.booleans())
def test_positions_alone_make_a_path_of_continuous_acceleration(steps: list[float], seed: int, moving: bool) -> None:
    waypoints = points(steps, seed)
    path = path_through(waypoints, start(seed), 0.5) if moving else path_through(waypoints)
    for time in path.times[1:-1]:
        left, right = before(path, time).acceleration, path.state(time).acceleration
        np.testing.assert_allclose(left, right, rtol=1e-6, atol=1e-6 * np.abs(path.coefficients[..., 2]).max())
    if moving:
        same(path.state(0.5), start(seed))


def test_spline_agrees_with_the_closed_form() -> None:
    # Clamped spline through 0, 1, 0: velocity 0 in the middle by symmetry; through 0, 1, 2: 4 v = 3 * 2.
    middle = [
        path_through(Waypoints.of(["axis1"], [0, 1, 2], [[0], [1], [p]])).state(1.0).velocity[0] for p in (0.0, 2.0)
    ]
    np.testing.assert_allclose(middle, [0.0, 1.5], atol=1e-12)


def test_given_velocities_are_kept_and_missing_ones_computed() -> None:
    path = path_through(Waypoints.of(["axis1"], [0, 1, 2, 3], [[0], [1], [0], [2]], [None, [3.0], None, [0.0]]))
    np.testing.assert_allclose(path.state(1.0).velocity, 3.0)
    np.testing.assert_allclose(before(path, 2.0).acceleration, path.state(2.0).acceleration)


def test_state_accepts_arrays_of_times_and_holds_outside_the_path() -> None:
    path = path_through(Waypoints.of(JOINTS, [1, 2], [[0, 0], [1, -1]], [[1, 1], [2, 2]]))
    state = path.state([[0.0, 1.0], [2.0, 5.0]])
    assert state.position.shape == (2, 2, 2)
    np.testing.assert_allclose(state.position[:, :, 0], [[0, 0], [1, 1]])
    np.testing.assert_allclose(state.velocity[:, :, 0], [[0, 1], [2, 0]])
    assert state.acceleration[0, 0, 0] == state.acceleration[1, 1, 0] == 0.0
    t, h = np.linspace(1.01, 1.99, 50), 1e-5
    slope = (path.state(t + h).position - path.state(t - h).position) / (2 * h)
    np.testing.assert_allclose(path.state(t).velocity, slope, atol=1e-8)
    slope = (path.state(t + h).velocity - path.state(t - h).velocity) / (2 * h)
    np.testing.assert_allclose(path.state(t).acceleration, slope, atol=1e-6)


def test_parts_and_shifts_of_a_path_are_the_same_motion() -> None:
    path = path_through(points([1.0, 2.0], 3))
    np.testing.assert_array_equal(path.select(["axis2"]).state(2.5).position, path.state(2.5).position[1:])
    np.testing.assert_allclose(path.shifted(4.0).state(6.5).position, path.state(2.5).position)
    assert (path.start_time, path.end_time, path.duration) == (1.0, 4.0, 3.0)
    held = Path.hold(JOINTS, [1.0, 2.0], 5.0).state([0.0, 5.0, 9.0])
    assert (held.position == [1.0, 2.0]).all()
    assert not held.velocity.any()


def test_one_waypoint_starts_from_the_state() -> None:
    path = path_through(Waypoints.of(JOINTS, [2.0], [[1.0, 2.0]]), start(1))
    same(path.state(0.0), start(1))
    same(path.state(2.0), State.at_rest([1.0, 2.0]))


def test_a_waypoint_at_the_start_is_replaced_by_the_state() -> None:
    state = State.at_rest([0.005, 0.0])
    path = path_through(Waypoints.of(JOINTS, [0.0, 1.0], [[0.0, 0.0], [1.0, 1.0]]), state)
    same(path.state(0.0), state)
    assert len(path.times) == 2
    held = path_through(Waypoints.of(JOINTS, [0.0], [[0.0, 0.0]]), state)
    same(held.state(0.0005), state)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((JOINTS, [], []), "there are no waypoints"),
        (((), [0.0], [[]]), "there are no joint names"),
        ((("axis1", "axis1"), [0.0], [[0, 0]]), "joint axis1 occurs twice; write each joint once"),
        ((JOINTS, [0, np.nan], [[0, 0], [1, 1]]), "time of point #1 is nan"),
        ((JOINTS, [0, 1, 1], [[0, 0]] * 3), "time between points 1 and 2 is not strictly increasing"),
        ((JOINTS, [0, 1], [[0, 0], [1, 1, 1]]), r"joint_names size \(2\) and positions \(3\) at point #1"),
        ((JOINTS, [0, 1], [[0, 0]]), "there are 1 rows of positions for 2 points"),
        ((JOINTS, [0, 1], [[0, 0], None]), "point #1 has no positions"),
        ((JOINTS, [0, 1], [[0, 0], [1, np.nan]]), "positions of axis2 at point #1 is nan; write a finite number"),
        ((JOINTS, [0, 1], [[0, 0], [1, 1]], [[0, 0], [np.inf, 0]]), "velocities of axis1 at point #1 is inf"),
        ((JOINTS, [0, 1], [[0, 0], [1, 1]], None, [None, [0, 0]]), "point #1 has accelerations but no velocities"),
    ],
)
def test_wrong_waypoints_are_refused(arguments: Any, sentence: str) -> None:
    with pytest.raises(TrajectoryError, match=sentence):
        Waypoints.of(*arguments)


@pytest.mark.parametrize(
    ("times", "state", "sentence"),
    [
        ([0.0, 1.0], State.at_rest([0.02, 0.0]), "axis1 is at 0.02 rad, but point #0 at the start time is at 0 rad"),
        ([-0.5, 1.0], State.at_rest([0.0, 0.0]), "point #0 is 0.5 s before the start"),
        ([1.0], None, "a single waypoint needs a start state"),
        (
            [0.0],
            State(*np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])),
            "the joints move, and the only point",
        ),
    ],
)
def test_points_that_do_not_fit_the_start_are_refused(times: list[float], state: State | None, sentence: str) -> None:
    with pytest.raises(TrajectoryError, match=sentence):
        path_through(Waypoints.of(JOINTS, times, [[0.0, 0.0]] * len(times)), state)


@given(gaps, st.integers(0, 1000), st.floats(0.0, 1.0))
def test_joining_a_running_path_makes_no_step(steps: list[float], seed: int, share: float) -> None:
    path = path_through(points(steps, seed))
    now = path.start_time + 0.999 * share * path.duration
    result = joined(start(seed), now, path)
    same(result.state(now), start(seed))
    same(before(result, float(result.times[1])), path.state(result.times[1]))
    assert result.times[1] >= now + 0.1 or result.times[1] == path.end_time
    t = np.linspace(result.times[1], path.end_time + 1.0, 50)
    np.testing.assert_allclose(result.state(t).position, path.state(t).position)
    np.testing.assert_allclose(result.state(t).effort, path.state(t).effort)


def test_a_path_that_has_ended_cannot_be_joined() -> None:
    path = Path.hold(JOINTS, [0, 0], 0.0, 1.0)
    with pytest.raises(TrajectoryError, match=r"ended 0\.5 s ago") as caught:
        joined(start(0), 1.5, path)
    assert caught.value.code is ErrorCode.OLD_HEADER_TIMESTAMP


@pytest.mark.parametrize("at", [2.2, 9.0])
def test_the_old_path_is_followed_until_the_new_one_begins(at: float) -> None:
    old = path_through(points([1.0, 2.0, 3.0], 1))
    new = path_through(Waypoints.of(JOINTS, [at + 1.0], [[0, 0]]), old.state(at), at)
    result = spliced(old, new, 1.5)

    def check(a: Path, t: Array) -> None:
        near(result.state(t).position, a.state(t).position)
        near(result.state(t).effort, a.state(t).effort)

    check(old, np.linspace(1.5, at, 100, endpoint=False))
    check(new, np.linspace(at, at + 2.0, 100))
    assert spliced(old, new, at) is new
