"""Streams of set-points on the board: tracking, bridged gaps, end, and replacement by other sources."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray
from path_simulation import CATALOGUE, COUNT, JOINTS, PathSimulation
from servo_bridge.set_points import JointSetPoint, Mode, SetPointRequest
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.shapes import lissajous
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.streamer import Streamer
from servo_bridge.trajectory.waypoints import Waypoints
from servo_msgs_py.joints import DEFAULT_JOINTS
from servo_twin.board import Board
from servo_twin.level import Level

LEVELS = pytest.mark.parametrize("level", ["ideal", "registers"])
OMEGA = 4.0 * math.pi
ROUNDING = 2.0 * COUNT / 1e-4
"""Apparent acceleration by rounding to counts [rad/s^2]."""


def wave(t: float) -> tuple[float, float]:
    """Position and velocity of a sine of 2 Hz and 1 rad, with a ramp of 0.5 s."""
    rise = min(max(t / 0.5, 0.0), 1.0)
    slope = 1.0 / 0.5 if 0.0 < t < 0.5 else 0.0
    return rise * math.sin(OMEGA * t), slope * math.sin(OMEGA * t) + rise * OMEGA * math.cos(OMEGA * t)


def both(t: float) -> Mapping[int, JointSetPoint]:
    return {0: JointSetPoint(*wave(t)), 1: JointSetPoint(*wave(t))}


def followed(sim: PathSimulation, begin: float, since: float, until: float) -> tuple[float, float]:
    """Largest lag [s] and largest error after its compensation [rad] of the joints."""
    time, table = sim.time(), sim.table()
    rows = (time >= begin + since) & (time < begin + until)
    t = time[rows] - begin
    lags, rests = [], []
    for joint in JOINTS:
        real = table[f"{joint}.position"][rows] * COUNT
        phase = np.exp(-1j * OMEGA * t)
        lag = float(np.angle((np.sin(OMEGA * t) * phase).sum() / (real * phase).sum()) / OMEGA)
        lags.append(lag)
        rests.append(float(np.abs(real - np.sin(OMEGA * (t - lag))).max()))
    return max(lags), max(rests)


def accelerations(sim: PathSimulation, joint: str, begin: float) -> NDArray[np.float64]:
    """Accelerations of the reference over 10 ms [rad/s^2]."""
    rows = sim.time() >= begin
    reference = sim.table()[f"{joint}.position_ref"][rows] * COUNT
    time = sim.time()[rows]
    grid = np.arange(time[0], time[-1], 0.01)
    result: NDArray[np.float64] = np.diff(np.interp(grid, time, reference), 2) / 1e-4
    return result


def moving(sim: PathSimulation) -> tuple[str, ...]:
    """Joints with an active stream."""
    report = sim.streamer.report
    return () if report is None else report.moving


@LEVELS
def test_stream_is_followed_with_a_known_delay(level: Level) -> None:
    with Board(seed=4, level=level) as board:
        sim = PathSimulation(board)
        begin = sim.send(3.0, both)
        lag, residual = followed(sim, begin, 1.0, 3.0)
        report = sim.streamer.report
        assert report is not None
        assert sim.errors == []
        assert sim.refusals == []
    assert residual <= 0.04
    assert abs(lag - report.delay) <= 0.002
    assert report.delay <= 0.08
    assert (report.lost, report.late, report.starved) == (0, 0, ())
    assert report.received == 300


@LEVELS
@pytest.mark.parametrize("delay_max", [None, 0.06])
def test_jitter_and_loss_cause_no_fault_and_no_step(level: Level, delay_max: float | None) -> None:
    with Board(seed=4, level=level) as board:
        sim = PathSimulation(board, delay_max)
        limit = sim.limits[0].acceleration_max
        begin = sim.send(3.0, both, jitter=0.05, loss=0.05)
        assert sim.errors == []
        table = sim.table()
        report = sim.streamer.report
        assert report is not None
        _, residual = followed(sim, begin, 1.0, 3.0)
    for joint in JOINTS:
        assert not table[f"{joint}.faults"].any()
        assert table[f"{joint}.points_late"][-1] == 0
        assert np.abs(accelerations(sim, joint, begin)).max() <= limit + ROUNDING
    assert report.lost > 5
    assert 0.03 < report.jitter < 0.06
    if delay_max is not None:
        assert residual <= 0.1


def test_lead_increases_until_points_arrive_in_time() -> None:
    with Board(seed=4) as board:
        sim = PathSimulation(board)
        sim.streamer = Streamer(DEFAULT_JOINTS, sim.follower, 0.025)
        sim.write_delay = 0.025
        sim.send(5.0, both)
        error_count = len(sim.errors)
        assert error_count > 0
        resumed = sim.send(3.0, lambda t: both(t + 5.0))
        assert len(sim.errors) == error_count
        _, residual = followed(sim, resumed - 5.0, 6.0, 8.0)
        report = sim.streamer.report
        assert report is not None
    assert 0.06 < report.delay < 0.12
    assert residual <= 0.04


def test_missing_messages_of_a_stream_cause_a_stop() -> None:
    with Board(seed=4) as board:
        sim = PathSimulation(board)
        sim.send(1.0, lambda t: {0: JointSetPoint(20.0 * t, 20.0)})
        assert sim.table()["axis1.speed"][-1] > 0
        sim.run(0.5)
        table = sim.table()
        assert not table["axis1.faults"].any()
        assert np.ptp(table["axis1.position_ref"][-10:]) == 0
        travelled = (table["axis1.position_ref"][-1] - table["axis1.position_ref"][0]) * COUNT
        assert 19.0 < travelled < 20.0 + 1.5
        assert sim.follower.axes == frozenset()
        # The stream starts again.
        at = table["axis1.position_ref"][-1] * COUNT
        begin = sim.send(1.0, lambda t: {0: JointSetPoint(at + wave(t)[0], wave(t)[1])})
        sim.run(0.2)
        moved = np.ptp(sim.table()["axis1.position_ref"][sim.time() > begin]) * COUNT
        assert moved > 1.9
        assert sim.errors == []


def test_second_joint_joins_a_stream() -> None:
    with Board(seed=4) as board:
        sim = PathSimulation(board)

        def points(t: float) -> Mapping[int, JointSetPoint]:
            return {0: JointSetPoint(*wave(t))} | ({1: JointSetPoint(*wave(t - 1.0))} if t >= 1.0 else {})

        begin = sim.send(2.5, points)
        time, table = sim.time(), sim.table()
        early = (time > begin) & (time < begin + 1.0)
        assert np.ptp(table["axis2.position_ref"][early]) == 0
        assert np.ptp(table["axis1.position_ref"][early]) * COUNT > 1.5
        for joint in JOINTS:
            assert np.ptp(table[f"{joint}.position_ref"][time > begin + 1.0]) * COUNT > 1.9
        assert sim.errors == []


def test_stream_replaces_a_path_and_a_set_point_replaces_the_stream() -> None:
    with Board(seed=4) as board:
        sim = PathSimulation(board)

        def circle(running: Path, now: float) -> Path:
            shape = lissajous(JOINTS, [0.0, 0.0], [1.0, 1.0], [2.0, 2.0], 3.0).shifted(now)
            coefficients = shape.coefficients.copy()
            at = running.state(now).position
            coefficients[..., 0] += at
            return Path(JOINTS, shape.times, coefficients, shape.end + at)

        sim.follow(circle)
        sim.run(1.13)
        begin = sim.send(1.0, both)
        limit = sim.limits[0].acceleration_max
        for joint in JOINTS:
            assert np.abs(accelerations(sim, joint, begin)).max() <= limit + ROUNDING
        assert moving(sim) == JOINTS
        sim.arbiter.submit(SetPointRequest("test", Mode.POSITION, {0: 3.0}))
        sim.dispatcher.pump()
        sim.run(0.5)
        table = sim.table()
        assert abs(table["axis1.position_ref"][-1] * COUNT - 3.0) < 0.01
        assert moving(sim) == ()
        assert sim.errors == []
        assert sim.refusals == []


def limited(board: Board, *, position_max: float) -> None:
    """Switch the soft limits of the board on [rad]."""
    mask = CATALOGUE.flag("features", "POSITION_LIMITS").mask
    board.write_raw("param.features", [raw | mask for raw in board.read_words("param.features")])
    board.write("param.position_max", [position_max] * 2)
    board.run(0.01)


@pytest.mark.parametrize("speed", [4.0, 6.0, 60.0])
def test_stream_keeps_a_soft_limit_when_its_messages_end(speed: float) -> None:
    with Board(seed=4) as board:
        limited(board, position_max=12.0)
        sim = PathSimulation(board)
        rise = min(1.0, 8.0 / speed)

        def point(t: float) -> Mapping[int, JointSetPoint]:
            if t < rise:
                return {0: JointSetPoint(0.5 * speed * t * t / rise, speed * t / rise)}
            return {0: JointSetPoint(speed * (t - 0.5 * rise), speed)}

        sim.send(0.5 * rise + 11.9 / speed, point)
        sim.run(1.0)
        table = sim.table()
        assert sim.errors == []
        assert not table["axis1.faults"].any()
        assert 11.0 < table["axis1.position_ref"].max() * COUNT <= 12.0
        assert table["axis1.position"].max() * COUNT <= 12.0 + 0.02
        assert np.ptp(table["axis1.position_ref"][-10:]) == 0


@pytest.mark.parametrize("interface", ["stream", "path"])
def test_joint_outside_of_its_soft_limit_returns_and_moves_no_further(interface: str) -> None:
    with Board(seed=4) as board:
        sim = PathSimulation(board)
        sim.arbiter.submit(SetPointRequest("test", Mode.POSITION, {0: 3.0}))
        sim.dispatcher.pump()
        sim.run(0.5)
        limited(board, position_max=2.0)
        sim.read_limits()
        sim.run(0.1)

        def path_to(target: float) -> None:
            sim.follow(lambda running, now: from_running(running, now, target), ["axis1"])
            sim.run(1.5)

        def stream_to(target: float) -> None:
            at = sim.table()["axis1.position_ref"][-1] * COUNT
            sim.send(1.0, lambda t: {0: JointSetPoint(at + (target - at) * t, target - at)})
            sim.send(0.5, lambda t: {0: JointSetPoint(target, 0.0)})

        go = path_to if interface == "path" else stream_to
        go(3.3)
        assert sim.table()["axis1.position_ref"].max() * COUNT <= 3.0 + 2.0 * COUNT
        assert bool(sim.refusals) is (interface == "path")
        for target in (2.5, 1.0):
            go(target)
            assert sim.table()["axis1.position_ref"][-1] * COUNT == pytest.approx(target, abs=0.01)
        assert sim.errors == []


def from_running(running: Path, now: float, target: float) -> Path:
    """Path of 1 s of the first joint, from its state at a time to a position at rest."""
    mine = running.select(["axis1"])
    return path_through(Waypoints.of(["axis1"], [now + 1.0], [[target]]), mine.state(now), now)
