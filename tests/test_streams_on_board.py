"""Streams of set-points that the bridge brings to the board: followed, bridged, ended, taken over."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray
from path_world import COUNT, JOINTS, PathWorld
from servo_bridge.set_points import JointSetPoint, Mode, SetPointRequest
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.shapes import lissajous
from servo_bridge.trajectory.streamer import Streamer
from servo_msgs_py.joints import DEFAULT_JOINTS
from servo_twin.board import Board
from servo_twin.level import Level

LEVELS = pytest.mark.parametrize("level", ["ideal", "registers"])
OMEGA = 4.0 * math.pi
ROUNDING = 2.0 * COUNT / 1e-4
"""Acceleration that whole counts make out of nothing [rad/s^2]."""


def wave(t: float) -> tuple[float, float]:
    """Position and velocity of 2 Hz, 1 rad, faded in over half a second."""
    rise = min(max(t / 0.5, 0.0), 1.0)
    slope = 1.0 / 0.5 if 0.0 < t < 0.5 else 0.0
    return rise * math.sin(OMEGA * t), slope * math.sin(OMEGA * t) + rise * OMEGA * math.cos(OMEGA * t)


def both(t: float) -> Mapping[int, JointSetPoint]:
    return {0: JointSetPoint(*wave(t)), 1: JointSetPoint(*wave(t))}


def followed(world: PathWorld, begin: float, since: float, until: float) -> tuple[float, float]:
    """Lag [s] and what the error is besides it [rad], of the worst joint."""
    time, table = world.time(), world.table()
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


def accelerations(world: PathWorld, joint: str, begin: float) -> NDArray[np.float64]:
    """Of the reference, over 10 ms [rad/s^2]."""
    rows = world.time() >= begin
    reference = world.table()[f"{joint}.position_ref"][rows] * COUNT
    time = world.time()[rows]
    grid = np.arange(time[0], time[-1], 0.01)
    result: NDArray[np.float64] = np.diff(np.interp(grid, time, reference), 2) / 1e-4
    return result


def moving(world: PathWorld) -> tuple[str, ...]:
    """Joints that a stream moves."""
    report = world.streamer.report
    return () if report is None else report.moving


@LEVELS
def test_a_stream_is_followed_a_known_delay_later(level: Level) -> None:
    with Board(seed=4, level=level) as board:
        world = PathWorld(board)
        begin = world.send(3.0, both)
        lag, rest = followed(world, begin, 1.0, 3.0)
        report = world.streamer.report
        assert report is not None
        assert world.troubles == []
        assert world.refusals == []
    assert rest <= 0.04
    assert abs(lag - report.delay) <= 0.002
    assert report.delay <= 0.08
    assert (report.lost, report.late, report.starved) == (0, 0, ())
    assert report.received == 300


@LEVELS
@pytest.mark.parametrize("delay_max", [None, 0.06])
def test_jitter_and_loss_make_no_fault_and_no_step(level: Level, delay_max: float | None) -> None:
    with Board(seed=4, level=level) as board:
        world = PathWorld(board, delay_max)
        limit = world.limits[0].acceleration_max
        begin = world.send(3.0, both, jitter=0.05, loss=0.05)
        assert world.troubles == []
        table = world.table()
        report = world.streamer.report
        assert report is not None
        _, rest = followed(world, begin, 1.0, 3.0)
    for joint in JOINTS:
        assert not table[f"{joint}.faults"].any()
        assert table[f"{joint}.points_late"][-1] == 0
        assert np.abs(accelerations(world, joint, begin)).max() <= limit + ROUNDING
    assert report.lost > 5
    assert 0.03 < report.jitter < 0.06
    if delay_max is not None:
        assert rest <= 0.1


def test_the_lead_grows_until_points_come_in_time_over_a_slow_line() -> None:
    with Board(seed=4) as board:
        world = PathWorld(board)
        world.streamer = Streamer(DEFAULT_JOINTS, world.follower, 0.025)
        world.write_delay = 0.025
        world.send(5.0, both)
        troubles = len(world.troubles)
        assert troubles > 0
        resumed = world.send(3.0, lambda t: both(t + 5.0))
        assert len(world.troubles) == troubles
        _, rest = followed(world, resumed - 5.0, 6.0, 8.0)
        report = world.streamer.report
        assert report is not None
    assert 0.06 < report.delay < 0.12
    assert rest <= 0.04


def test_points_that_come_nearly_late_make_the_lead_longer_without_a_step() -> None:
    with Board(seed=4) as board:
        world = PathWorld(board)
        limit = world.limits[0].acceleration_max
        begin = world.send(1.0, both)
        assert world.streamer.report is not None
        before = world.streamer.report.delay
        world.streamer.arrived(-0.02)
        world.send(2.0, lambda t: both(t + 1.0))
        after = world.streamer.report.delay
        assert world.troubles == []
    assert after - before == pytest.approx(0.028, abs=0.001)
    for joint in JOINTS:
        assert np.abs(accelerations(world, joint, begin)).max() <= limit + ROUNDING


def test_a_sender_that_dies_leaves_a_stop() -> None:
    with Board(seed=4) as board:
        world = PathWorld(board)
        world.send(1.0, lambda t: {0: JointSetPoint(20.0 * t, 20.0)})
        assert world.table()["axis1.speed"][-1] > 0
        world.run(0.5)
        table = world.table()
        assert not table["axis1.faults"].any()
        assert np.ptp(table["axis1.position_ref"][-10:]) == 0
        travelled = (table["axis1.position_ref"][-1] - table["axis1.position_ref"][0]) * COUNT
        assert 19.0 < travelled < 20.0 + 1.5
        assert world.follower.axes == frozenset()
        # And begins again.
        at = table["axis1.position_ref"][-1] * COUNT
        begin = world.send(1.0, lambda t: {0: JointSetPoint(at + wave(t)[0], wave(t)[1])})
        world.run(0.2)
        moved = np.ptp(world.table()["axis1.position_ref"][world.time() > begin]) * COUNT
        assert moved > 1.9
        assert world.troubles == []


def test_one_joint_streams_and_the_other_joins() -> None:
    with Board(seed=4) as board:
        world = PathWorld(board)

        def points(t: float) -> Mapping[int, JointSetPoint]:
            return {0: JointSetPoint(*wave(t))} | ({1: JointSetPoint(*wave(t - 1.0))} if t >= 1.0 else {})

        begin = world.send(2.5, points)
        time, table = world.time(), world.table()
        early = (time > begin) & (time < begin + 1.0)
        assert np.ptp(table["axis2.position_ref"][early]) == 0
        assert np.ptp(table["axis1.position_ref"][early]) * COUNT > 1.5
        for joint in JOINTS:
            assert np.ptp(table[f"{joint}.position_ref"][time > begin + 1.0]) * COUNT > 1.9
        assert world.troubles == []


def test_a_stream_takes_over_from_a_path_and_gives_way_to_a_set_point() -> None:
    with Board(seed=4) as board:
        world = PathWorld(board)

        def circle(running: Path, now: float) -> Path:
            shape = lissajous(JOINTS, [0.0, 0.0], [1.0, 1.0], [2.0, 2.0], 3.0).shifted(now)
            coefficients = shape.coefficients.copy()
            at = running.state(now).position
            coefficients[..., 0] += at
            return Path(JOINTS, shape.times, coefficients, shape.end + at)

        world.follow(circle)
        world.run(1.13)
        begin = world.send(1.0, both)
        limit = world.limits[0].acceleration_max
        for joint in JOINTS:
            assert np.abs(accelerations(world, joint, begin)).max() <= limit + ROUNDING
        assert moving(world) == JOINTS
        world.arbiter.submit(SetPointRequest("test", Mode.POSITION, {0: 3.0}))
        world.dispatcher.pump()
        world.run(0.5)
        table = world.table()
        assert abs(table["axis1.position_ref"][-1] * COUNT - 3.0) < 0.01
        assert moving(world) == ()
        assert world.troubles == []
        assert world.refusals == []


def test_a_stream_at_the_limit_of_acceleration_is_not_refused() -> None:
    with Board(seed=4) as board:
        world = PathWorld(board)
        board.write("param.acceleration_limit", [200.0, 200.0])
        board.run(0.01)
        limits = world.limits
        world.limits = [type(limit)(acceleration_max=200.0, velocity_max=50.0) for limit in limits]
        begin = world.send(2.0, lambda t: {0: JointSetPoint(30.0, 0.0), 1: JointSetPoint(-30.0, 0.0)})
        world.run(0.2)
        table = world.table()
        assert world.troubles == []
        assert abs(table["axis1.position_ref"][-1] * COUNT - 30.0) < 0.02
        assert abs(table["axis2.position_ref"][-1] * COUNT + 30.0) < 0.02
        assert 150.0 < np.abs(accelerations(world, "axis1", begin)).max() <= 200.0 + ROUNDING
