"""Streams of set-points over a bad network: no step, limited acceleration, correct figures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_bridge.trajectory.playout import JITTER_MAX, PlayoutClock, PlayoutFigures
from servo_bridge.trajectory.stream import Stream
from servo_bridge.trajectory.tracker import Tracker
from servo_bridge.trajectory.waypoints import Array
from servo_msgs_py.units import PERIOD

LIMIT = 100.0  # acceleration [rad/s^2]
LEAD = 0.02  # [s]
BEGIN = 1000.0
"""Local time at time 0 of the sender [s]."""
TRANSIT = 0.003  # shortest transit time of a message [s]
OMEGA = math.pi  # of the sine [rad/s]


@dataclass
class Result:
    times: Array  # (points,), time of the receiver [s]
    positions: Array  # (points,), [rad]
    velocities: Array  # (points,), [rad/s]
    reports: list[PlayoutFigures]
    states: list[tuple[bool, bool]]  # moving, starved

    @property
    def accelerations(self) -> Array:
        result: Array = np.diff(self.velocities) / np.diff(self.times)
        return result


def stream_from(position: float, velocity_max: float = math.inf, **options: Any) -> Stream:
    return Stream(Tracker(position, 0.0, LIMIT, velocity_max), LEAD, 0, **options)


def run(
    *, period: float = 0.02, jitter: float = 0.0, loss: float = 0.0, seconds: float = 10.0, seed: int = 1,
    velocities: bool = True, pause: tuple[float, float] = (99.0, 99.0), drift: float = 0.0, **options: Any,
) -> Result:  # fmt: skip
    """Result of a sine of 2 rad and 0.5 Hz through a network, fetched every 5 ms until 1 s after the last message."""
    random = np.random.default_rng(seed)
    sent = np.arange(round(seconds / period)) * period
    arrivals = BEGIN + TRANSIT + sent * (1.0 + drift) + random.uniform(0.0, jitter, len(sent))
    kept = (random.uniform(size=len(sent)) >= loss) & ~((sent > pause[0]) & (sent < pause[1]))
    events = sorted(zip(arrivals[kept], sent[kept], strict=True))
    stream = stream_from(0.0, **options)
    rows: list[Array] = []
    reports, states = [], []
    for now in np.arange(BEGIN, BEGIN + seconds + 1.0, 0.005):
        while events and events[0][0] <= now:
            arrival, stamp = events.pop(0)
            speed = 2.0 * OMEGA * math.cos(OMEGA * stamp)
            stream.take(stamp, arrival, 2.0 * math.sin(OMEGA * stamp), speed if velocities else None)
        p = stream.points(now + LEAD)
        reports.append(stream.clock.figures)
        states.append((stream.moving, stream.starved))
        if p is not None:
            assert p.periods[-1] * PERIOD <= now + LEAD + 1e-9
            rows.append(np.stack((p.periods * PERIOD, p.positions, p.velocities)))
    times, places, speeds = np.concatenate(rows, axis=1)
    return Result(times, places, speeds, reports, states)


def assert_smooth(result: Result) -> None:
    h = np.diff(result.times)
    assert (h > 0.0).all()
    assert np.abs(result.accelerations).max() <= LIMIT * (1.0 + 1e-6)
    # The Hermite segment of the board has a constant acceleration between points.
    mean = 0.5 * (result.velocities[1:] + result.velocities[:-1])
    np.testing.assert_allclose(np.diff(result.positions), mean * h, atol=1e-7)


def error_of(result: Result, delay: float, begin: float = 3.0, end: float = 9.5) -> float:
    """Largest error to the sine with a delay [rad]."""
    inside = (result.times > BEGIN + begin) & (result.times < BEGIN + end)
    expected = 2.0 * np.sin(OMEGA * (result.times[inside] - BEGIN - delay))
    return float(np.abs(result.positions[inside] - expected).max())


def test_an_even_stream_is_reproduced_a_period_later() -> None:
    result = run()
    assert_smooth(result)
    report = result.reports[-300]
    assert report.delay == pytest.approx(LEAD + 0.02, abs=1e-6)
    assert report.period == pytest.approx(0.02)
    assert report.jitter == pytest.approx(0.0, abs=1e-9)
    assert (report.lost, report.late) == (0, 0)
    assert error_of(result, TRANSIT + report.delay) < 1e-4
    steady = result.accelerations[200:900]
    assert np.abs(steady).max() < 1.01 * 2.0 * OMEGA**2


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("velocities", [True, False])
@pytest.mark.parametrize(("delay_max", "near"), [(0.1, 0.03), (None, 0.15)])
def test_jitter_and_losses_make_no_step(seed: int, velocities: bool, delay_max: float | None, near: float) -> None:
    result = run(jitter=0.05, loss=0.05, seed=seed, velocities=velocities, delay_max=delay_max)
    assert_smooth(result)
    report = result.reports[-300]
    assert report.jitter == pytest.approx(0.0475, abs=0.006)
    assert error_of(result, TRANSIT + report.delay) < near
    bound = 0.02 + (min(report.jitter, JITTER_MAX) if delay_max is None else report.jitter)
    assert report.delay == pytest.approx(LEAD + bound, abs=0.003)


@given(st.integers(0, 10_000), st.floats(0.005, 0.1), st.floats(0.0, 0.2), st.floats(0.0, 0.5))
def test_arbitrary_delays_and_losses_cause_no_step(seed: int, period: float, jitter: float, loss: float) -> None:
    assert_smooth(run(seconds=2.0, period=period, jitter=jitter, loss=loss, seed=seed))


def test_bridged_delay_covers_late_messages() -> None:
    few = run(jitter=0.05, delay_max=0.1).reports[-1].late
    many = run(jitter=0.05, delay_max=0.0).reports[-1].late
    assert few < 30 < 200 < many


def test_losses_are_counted() -> None:
    report = run(loss=0.1, seed=3, seconds=20.0).reports[-1]
    assert report.received + report.lost == pytest.approx(1000, abs=3)
    assert report.lost == pytest.approx(100, abs=30)
    disordered = run(jitter=0.05, seconds=10.0, delay_max=0.0).reports[-1]
    assert disordered.received == 500
    assert disordered.lost <= 1


def test_drift_of_the_clocks_is_followed() -> None:
    result = run(seconds=30.0, drift=5e-4)
    assert_smooth(result)
    # After 25 s the clocks differ by 12.5 ms; the window covers the last 2.5 s.
    assert error_of(result, TRANSIT + LEAD + 0.02 + 12.5e-3, 24.9, 25.1) < 2.0 * OMEGA * 2e-3


def test_a_stream_stops_in_a_pause_and_continues_after_it() -> None:
    result = run(pause=(4.0, 6.0))
    assert_smooth(result)
    assert (True, True) in result.states
    assert (False, False) in result.states[100:-200]
    gap = np.argmax(np.diff(result.times))
    assert result.times[gap + 1] - result.times[gap] > 1.0
    assert result.velocities[gap] == 0.0
    assert result.positions[gap] == result.positions[gap + 1]
    # Stop of the reference: velocity 2 pi, one period and the lead bridged, half the limit.
    overrun = 2.0 * OMEGA * (0.02 + LEAD) + 0.5 * (2.0 * OMEGA) ** 2 / (0.5 * LIMIT)
    assert 0.0 < result.positions[gap] < 1.05 * overrun
    assert error_of(result, TRANSIT + LEAD + 0.02, 8.0) < 1e-3
    assert result.states[-1] == (False, False)


def test_joint_moves_from_its_position_to_the_set_point() -> None:
    stream = stream_from(2.0)
    assert stream.points(5.0) is None, "there is no message"
    for k in range(100):
        stream.take(0.02 * k, 5.0 + 0.02 * k, 3.0)
        points = stream.points(5.0 + 0.02 * k + LEAD)
        if k == 0:
            assert points is None or points.positions[0] == 2.0
    assert stream.moving
    assert points is not None
    assert points.positions[-1] == pytest.approx(3.0)


def test_joint_whose_messages_end_in_motion_stops() -> None:
    stream = stream_from(0.0)
    velocity = math.inf
    for k in range(300):
        if k < 100:
            stream.take(0.01 * k, 5.0 + 0.01 * k, 0.05 * k, 5.0)
        points = stream.points(5.0 + 0.01 * k + LEAD)
        velocity = velocity if points is None else points.velocities[-1]
        if k == 99:
            assert velocity == pytest.approx(5.0, abs=0.3)
    assert velocity == 0.0
    assert not stream.moving


@pytest.mark.parametrize("step", [-50.0, 50.0])
def test_stream_continues_after_a_clock_step_of_the_sender(step: float) -> None:
    stream = stream_from(0.0)
    last = 0.0
    for k in range(400):
        stream.take(0.01 * k + (step if k >= 100 else 0.0), 5.0 + 0.01 * k, 0.01 * k, 1.0)
        points = stream.points(5.0 + 0.01 * k + LEAD)
        last = last if points is None else points.positions[-1]
    assert last == pytest.approx(3.99, abs=0.05)
    assert not stream.starved


def test_velocity_limit_is_kept() -> None:
    stream = stream_from(0.0, 2.0)
    speeds: list[float] = []
    for k in range(300):
        stream.take(0.01 * k, 5.0 + 0.01 * k, 3.0)
        points = stream.points(5.0 + 0.01 * k + LEAD)
        speeds += [] if points is None else points.velocities.tolist()
    assert max(speeds) == pytest.approx(2.0)
    assert points is not None
    assert points.positions[-1] == pytest.approx(3.0)


def test_wrong_limits_are_refused() -> None:
    for wrong in (0.0, math.nan):
        with pytest.raises(ValueError, match="limits must be above 0"):
            Stream(Tracker(0.0, 0.0, wrong), LEAD, 0)


@given(st.floats(-10, 10), st.floats(-20, 20), st.floats(0, 20))
def test_the_tracker_arrives_without_overshoot_of_a_step(position: float, velocity: float, target: float) -> None:
    tracker = Tracker(position, velocity, LIMIT)
    farthest = 0.0
    side = math.copysign(1.0, target - position - 0.5 * velocity * abs(velocity) / LIMIT)
    for _ in range(400):
        tracker.advance(target, 0.0, 0.0, 0.01)
        farthest = max(farthest, side * (tracker.position - target))
    assert tracker.position == pytest.approx(target, abs=1e-6)
    if side * velocity >= 0.0:
        assert farthest < 0.05


def test_the_tracker_keeps_its_limits_beside_a_reference_that_does_not() -> None:
    tracker = Tracker(0.0, 9.0, LIMIT, 5.0)
    time, speeds = 0.0, [9.0]
    while time < 5.0:
        tracker.advance(0.5 * LIMIT * time**2 if time < 0.1 else 0.5, 0.0, LIMIT if time < 0.1 else 0.0, 0.01)
        speeds.append(tracker.velocity)
        time += 0.01
    assert np.abs(np.diff(speeds)).max() <= 1.0001 * LIMIT * 0.01
    assert min(speeds) >= -5.0 - 1e-9
    assert tracker.position == pytest.approx(0.5, abs=1e-6)
    exact = Tracker(0.0, 0.0, LIMIT)
    exact.advance(0.0, 0.0, LIMIT, 0.01)
    assert exact.velocity == pytest.approx(LIMIT * 0.01)


def test_the_delay_changes_slowly() -> None:
    clock = PlayoutClock(LEAD, 0.2)
    stamps = []
    for k in range(400):
        clock.add_message(0.01 * k, 5.0 + 0.01 * k + (0.1 if k % 2 and k > 50 else 0.0))
        stamp, rate = clock.due(5.0 + 0.01 * k, 0.01)
        stamps.append(stamp)
        if k:
            assert rate * 0.01 == pytest.approx(stamps[-1] - stamps[-2])
    steps = np.diff(stamps)
    assert steps.min() == pytest.approx(0.95 * 0.01)
    assert clock.delay == pytest.approx(LEAD + 0.11)


def test_effort_is_copied_to_points() -> None:
    stream = stream_from(0.0)
    efforts: list[float] = []
    for k in range(100):
        stream.take(0.01 * k, 5.0 + 0.01 * k, 0.0, 0.0, 0.01 * k)
        points = stream.points(5.0 + 0.01 * k + LEAD)
        efforts += [] if points is None else points.efforts.tolist()
    np.testing.assert_allclose(np.diff(efforts[20:90]), 0.01, atol=1e-4)


# ---- limits and rejoining
def fetched(stream: Stream, messages: list[tuple[float, float, float | None]], until: float) -> tuple[Array, Array]:
    """Positions and velocities of the points of a stream; messages are time, position and velocity."""
    rows: list[Array] = []
    waiting = list(messages)
    for now in np.arange(0.0, until, 0.005):
        while waiting and waiting[0][0] <= now:
            time, position, velocity = waiting.pop(0)
            stream.take(time, now, position, velocity)
        points = stream.points(now + LEAD)
        rows += [] if points is None else [np.stack((points.positions, points.velocities))]
    positions, velocities = np.concatenate(rows, axis=1)
    return positions, velocities


@pytest.mark.parametrize("speed", [4.0, 6.0, 30.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_stream_brakes_in_time_before_a_position_limit(speed: float, side: float) -> None:
    """The messages lead beyond the limit, and end at it; extrapolated, they would pass it."""
    limit = 6.0
    stream = Stream(Tracker(0.0, 0.0, LIMIT, position_min=-limit, position_max=limit), LEAD, 0)
    times = np.arange(0.0, limit / speed, 0.01)
    positions, velocities = fetched(stream, [(t, side * speed * t, side * speed) for t in times.tolist()], 4.0)
    assert np.abs(positions).max() <= limit + 1e-9
    assert np.abs(velocities).max() > min(0.9 * speed, 15.0)
    assert velocities[-1] == 0.0
    assert np.abs(np.diff(velocities)).max() <= LIMIT * 0.01 * (1.0 + 1e-6)
    # The Hermite segments between the points keep the limit as well.
    peaks = positions[:-1] + velocities[:-1] ** 2 / (2.0 * np.maximum(-side * np.diff(velocities) / 0.01, 1e-9)) * side
    turned = (side * velocities[:-1] > 0.0) & (side * velocities[1:] < 0.0)
    assert (side * peaks[turned] <= limit + 1e-9).all()


def test_a_stream_that_stops_at_a_position_limit_ends() -> None:
    stream = Stream(Tracker(0.0, 0.0, LIMIT, position_min=-1.0, position_max=1.0), LEAD, 0)
    fetched(stream, [(t, 4.0 * t, 4.0) for t in np.arange(0.0, 0.24, 0.01).tolist()], 1.5)
    assert not stream.moving


@given(
    st.floats(-3.0, 3.0), st.floats(-8.0, 8.0), st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=20),
    st.sampled_from([0.01, 0.005]),
)  # fmt: skip
def test_the_tracker_never_leaves_its_position_limits(
    position: float, velocity: float, targets: list[float], step: float
) -> None:
    tracker = Tracker(position, velocity, LIMIT, position_min=-4.0, position_max=4.0)
    for target in targets:
        for _ in range(10):
            before = tracker.velocity
            tracker.advance(target, 0.0, 0.0, step)
            assert abs(tracker.velocity - before) <= LIMIT * step * (1.0 + 1e-9)
            assert abs(tracker.position) <= 4.0 + 1e-9
            turns = before * tracker.velocity < 0.0
            acceleration = abs(tracker.velocity - before) / step
            peak = abs(tracker.position) + (tracker.velocity**2 / (2.0 * acceleration) if turns else 0.0)
            assert peak <= 4.0 + 1e-9


@pytest.mark.parametrize("target", [0.0, 4.1, 9.0])
def test_the_tracker_returns_from_outside_of_its_limits_and_moves_no_further(target: float) -> None:
    tracker = Tracker(4.3, 0.0, LIMIT, position_min=-4.0, position_max=4.0)
    last = 4.3
    for _ in range(300):
        tracker.advance(target, 0.0, 0.0, 0.01)
        assert tracker.position <= last + 1e-12 or tracker.position <= 4.0 + 1e-9
        last = max(tracker.position, 4.0)
    assert tracker.position == pytest.approx(min(target, 4.3), abs=1e-6)


@pytest.mark.parametrize("velocities", [True, False])
@pytest.mark.parametrize("gap", [0.1, 0.25, 0.5])
def test_a_stream_that_lost_time_is_rejoined_within_its_own_speed(gap: float, velocities: bool) -> None:
    """Points were refused: the joint stands, and a new stream begins with the messages after the gap."""
    speed, lost = 2.0, 2.0 * gap
    stream = Stream(Tracker(0.0, 0.0, 4000.0, 300.0), LEAD, 0)
    times = np.arange(0.0, 3.0, 0.01)
    given = speed if velocities else None
    positions, speeds = fetched(stream, [(t, lost + speed * t, given) for t in times.tolist()], 3.0)
    assert np.abs(speeds).max() <= 1.5 * speed + 0.5 + 1e-9
    assert np.abs(np.diff(speeds)).max() / 0.01 <= (1.5 * speed + 0.5) / 0.1 + 1e-6
    assert positions[-1] == pytest.approx(lost + speed * 2.98, abs=0.021)
