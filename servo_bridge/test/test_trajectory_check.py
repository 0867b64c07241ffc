"""Limits between waypoints: exact extrema compared with dense sampling."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from servo_bridge.trajectory import waypoints
from servo_bridge.trajectory.check import Limits, first_violation, require
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.polynomials import enclosure, extrema
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.waypoints import Array, Waypoints

MODEL = Limits(inertia=0.3, viscous=0.2, coulomb=0.5)
QUANTITIES = ("position_max", "position_min", "velocity_max", "acceleration_max", "torque_max")


def random_path(seed: int, *, quintic: bool = False) -> Path:
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.05, 1.0, 5))
    rows = random.uniform(-2.0, 2.0, (4, 5, 1))
    return path_through(
        Waypoints.of(["axis1"], times, rows[0], rows[1], 20.0 * rows[2] if quintic else None, 0.3 * rows[3])
    )


def sampled(path: Path, name: str) -> tuple[Array, Array]:
    """Times and magnitude, including both sides of every breakpoint and reversal, where Coulomb friction jumps."""
    inside = [np.linspace(a, b, 4001)[:-1] for a, b in zip(path.times[:-1], path.times[1:], strict=True)]
    t = np.sort(np.concatenate((*inside, path.times[1:] - 1e-12)))
    sign = np.sign(path.continued(t).velocity[:, 0])
    reverses = np.flatnonzero(sign[:-1] * sign[1:] < 0.0)
    low, high = t[reverses], t[reverses + 1]
    for _ in range(40):
        middle = 0.5 * (low + high)
        before = np.sign(path.continued(middle).velocity[:, 0]) == sign[reverses]
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    t = np.sort(np.concatenate((t, low, high)))
    s = path.continued(t)
    p, v, a, e = (x[:, 0] for x in (s.position, s.velocity, s.acceleration, s.effort))
    torque = MODEL.inertia * a + MODEL.viscous * v + MODEL.coulomb * np.sign(v) + e
    table = {"position_max": p, "position_min": -p, "velocity_max": abs(v), "acceleration_max": abs(a)}
    return t, table.get(name, abs(torque))


@given(st.integers(0, 10_000), st.sampled_from(QUANTITIES), st.booleans())
def test_limits_hold_exactly_where_sampling_finds_the_extremum(seed: int, name: str, quintic: bool) -> None:
    path = random_path(seed, quintic=quintic)
    t, values = sampled(path, name)
    peak = float(values.max())
    margin = 2e-4 * float(np.ptp(values))
    sign = -1.0 if name == "position_min" else 1.0
    if peak - margin <= 0.0 and not name.startswith("position"):
        return
    assert first_violation(path, [replace(MODEL, **{name: sign * (peak + margin)})]) is None
    violation = first_violation(path, [replace(MODEL, **{name: sign * (peak - margin)})])
    assert violation is not None
    assert violation.quantity == name.split("_")[0]
    first = int(np.argmax(values > peak - margin))
    assert t[max(first - 1, 0)] - 1e-6 <= violation.time <= t[first] + 1e-6
    value = sign * violation.value if name.startswith("position") else abs(violation.value)
    assert peak - margin < value <= peak + margin


def test_a_path_within_its_waypoints_can_leave_its_limits_between_them() -> None:
    path = path_through(Waypoints.of(["axis1"], [0, 1, 2], [[0], [1], [1]], [[0], [0.5], [0]]))
    violation = first_violation(path, [Limits(position_max=1.0)])
    assert violation is not None
    assert violation.time == pytest.approx(1.0, abs=1e-6)
    # Cubic 1 + 0.5 s (1 - s)^2: highest at s = 1/3.
    assert violation.value == pytest.approx(1.0 + 0.5 * 4 / 27)


def test_first_violation_of_all_joints_is_reported() -> None:
    path = path_through(Waypoints.of(["axis1", "axis2"], [3, 4, 5], [[0, 0], [0, 1], [1, 1]]))
    limits = [Limits(velocity_max=0.5), Limits(velocity_max=1.0)]
    with pytest.raises(
        TrajectoryError,
        match=r"^velocity of axis2 is above its limit 1 rad/s at 0\.\d+ s with a peak of 1\.\d+ rad/s; "
        r"use \d\.?\d* s or more for the motion instead of 2 s, or change the limit$",
    ):
        require(path, limits)
    require(path, [Limits(), Limits()])
    low = first_violation(path, [Limits(), Limits(velocity_max=1.0, position_min=0.5, position_max=3.0)])
    assert low is not None
    assert str(low) == "position of axis2 is below its limit 0.5 rad at 0 s with a peak of 0 rad"


def test_friction_at_a_reversal_and_at_rest_is_included() -> None:
    # Velocity from -1 to 1: Coulomb friction adds to the torque of the acceleration only after the reversal.
    turn = path_through(Waypoints.of(["axis1"], [0, 2], [[0], [0]], [[-1], [1]]))
    limits = Limits(torque_max=1.4, inertia=1.0, coulomb=0.5)
    violation = first_violation(turn, [limits])
    assert violation is not None
    assert violation.time == pytest.approx(1.0, abs=1e-6)
    assert violation.value == pytest.approx(1.5)
    rest = path_through(Waypoints.of(["axis1"], [0, 2], [[1], [1]]))
    assert first_violation(rest, [replace(limits, torque_max=0.1)]) is None


def test_a_motion_planned_to_its_limit_passes() -> None:
    path = path_through(Waypoints.of(["axis1"], [0, 1], [[0.1], [0.7]]))
    assert first_violation(path, [Limits(position_max=0.7, position_min=0.1, velocity_max=0.9)]) is None


@pytest.mark.parametrize(
    "wrong", [{"velocity_max": -1.0}, {"torque_max": math.nan}, {"position_min": 1.0, "position_max": 0.0}]
)
def test_invalid_limits_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"is nan|not negative|above position_max"):
        Limits(**wrong)


@given(st.lists(st.floats(-10, 10), min_size=6, max_size=6))
def test_ranges_of_polynomials(numbers: list[float]) -> None:
    coefficients = np.array(numbers)
    values = np.polynomial.polynomial.polyval(np.linspace(0, 1, 2001), coefficients)
    low, high = enclosure(coefficients)
    assert low <= values.min() + 1e-9
    assert high >= values.max() - 1e-9
    _, exact = extrema(coefficients)
    assert exact.max() == pytest.approx(values.max(), abs=2e-4)
    assert exact.max() >= values.max() - 1e-9
    assert exact.min() <= values.min() + 1e-9


def test_a_path_from_outside_of_the_position_limits_may_return_but_not_leave_again() -> None:
    limits = [Limits(position_max=1.0)]

    def through(*positions: float) -> Path:
        rows = [[x] for x in positions]
        return path_through(Waypoints.of(["axis1"], range(len(rows)), rows, [[0.0]] * len(rows)))

    require(through(3.0, 2.0, 0.0), limits)
    require(Path.hold(["axis1"], [3.0]), limits)
    for positions in ((3.0, 3.1, 0.0), (3.0, 0.0, 1.5), (3.0, 2.0, 2.5)):
        with pytest.raises(TrajectoryError, match="position of axis1 is above its limit"):
            require(through(*positions), limits)
    assert first_violation(through(3.0, 2.0, 0.0), limits) is not None


@given(
    times=st.lists(st.floats(0.01, 2.0), min_size=2, max_size=5),
    goals=st.lists(st.floats(-10.0, 10.0), min_size=5, max_size=5),
    limits=st.builds(
        Limits,
        velocity_max=st.floats(0.01, 100.0),
        acceleration_max=st.floats(0.01, 100.0),
        torque_max=st.floats(0.3, 10.0),
        inertia=st.floats(0.0, 1.0),
        viscous=st.floats(0.0, 1.0),
        coulomb=st.floats(0.0, 0.2),
    ),
)
@example(times=[1.0, 0.03125], goals=[0.0, 1.0, 0, 0, 0], limits=Limits(-9, 9, 1.0, 1.0, 1.0, 1.0, 0.0, 0.125))
def test_a_path_in_the_time_of_the_remedy_is_accepted(times: list[float], goals: list[float], limits: Limits) -> None:
    knots = np.cumsum([0.0, *times])
    positions = [[x] for x in (0.0, *goals)][: len(knots)]
    path = path_through(Waypoints.of(["axis1"], knots, positions))
    try:
        require(path, [limits])
    except TrajectoryError as error:
        time = re.search(r"use (\S+) s or more for the motion instead of", str(error))
        if time is None:  # no time that a path may have is long enough
            assert first_violation(path.in_time(waypoints.DURATION_MAX), [limits]) is not None
        else:
            require(path.in_time(float(time[1])), [limits])


def test_no_time_is_named_for_a_path_that_begins_in_motion() -> None:
    path = path_through(Waypoints.of(["axis1"], [0, 1], [[0], [5]], [[1], [0]]))
    with pytest.raises(TrajectoryError, match=r"^velocity .*; use more time for the motion, or change the limit$"):
        require(path, [Limits(velocity_max=2.0)])


def test_effort_that_no_time_reduces_is_named() -> None:
    path = path_through(Waypoints.of(["axis1"], [0, 1], [[0], [1]], efforts=[[2], [2]]))
    with pytest.raises(TrajectoryError, match=r"^torque .*; use less effort, or change the limit$"):
        require(path, [Limits(torque_max=1.0)])
