"""Paths from the bridge on the board: tracking, blending, refusals, end."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from path_simulation import COUNT, JOINTS, PathSimulation
from servo_bridge.trajectory.path import Path
from servo_bridge.trajectory.shapes import lissajous, move, stop
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.waypoints import Waypoints
from servo_msgs_py.catalogue import numbers
from servo_msgs_py.joints import Joint
from servo_twin.board import Board


@pytest.fixture(params=["ideal", "registers"])
def sim(request: pytest.FixtureRequest) -> Iterator[PathSimulation]:
    with Board(seed=4, level=request.param) as board:
        yield PathSimulation(board)


def moved(running: Path, now: float, path: Path) -> Path:
    """Path shifted to the present time and positions of the joints."""
    shifted = path.shifted(now)
    at = running.select(path.joints).state(now).position
    coefficients = shifted.coefficients.copy()
    coefficients[..., 0] += at
    return Path(path.joints, shifted.times, coefficients, shifted.end + at)


def circle(running: Path, now: float) -> Path:
    """Circle of 2 Hz and 1 rad on both axes."""
    return moved(running, now, lissajous(JOINTS, [0.0, 0.0], [1.0, 1.0], [2.0, 2.0], 3.0))


def errors(sim: PathSimulation, path: Path) -> np.ndarray:
    """Largest error of each joint during the path [rad]."""
    time = sim.time()
    rows = (time >= path.start_time) & (time <= path.end_time)
    reference = path.state(time[rows]).position
    table = sim.table()[rows]
    return np.array(
        [np.abs(table[f"{joint}.position"] * COUNT - reference[:, k]).max() for k, joint in enumerate(path.joints)]
    )


def test_circle_is_followed(sim: PathSimulation) -> None:
    paths: list[Path] = []

    def plan(running: Path, now: float) -> Path:
        paths.append(circle(running, now))
        return paths[-1]

    sim.follow(plan)
    sim.run(3.3)
    assert not sim.refusals
    assert not sim.errors
    (path,) = paths
    assert errors(sim, path).max() <= 0.02
    table = sim.table()
    for joint in JOINTS:
        assert np.ptp(table[f"{joint}.position"]) * COUNT > 1.95
        assert table[f"{joint}.points_late"][-1] == 0
        assert abs(table[f"{joint}.position_ref"][-1] * COUNT - path.end[JOINTS.index(joint)]) <= COUNT
        assert not table[f"{joint}.faults"].any()


def test_geared_joints_are_followed_in_their_own_units() -> None:
    joints = [Joint(JOINTS[0], 50.0, -1, 0.3), Joint(JOINTS[1], 4.0, 1, -1.0)]
    goal = [0.8, 2.0]
    with Board(seed=4, level="ideal") as board:
        sim = PathSimulation(board, joints=joints)

        def plan(running: Path, now: float) -> Path:
            return path_through(Waypoints.of(JOINTS, [now + 1.0], [goal]), running.state(now), now)

        sim.follow(plan)
        sim.run(1.5)
        assert not sim.refusals
        assert not sim.errors
        table = sim.table()
        for joint, end in zip(joints, goal, strict=True):
            motor = table[f"{joint.name}.position"][-1] * COUNT
            assert joint.position(motor) == pytest.approx(end, abs=4 * COUNT / joint.gear_ratio)
            assert not table[f"{joint.name}.faults"].any()

        def too_fast(running: Path, now: float) -> Path:
            return path_through(Waypoints.of(JOINTS, [now + 0.2], [[5.0, 2.0]]), running.state(now), now)

        sim.follow(too_fast)
        sim.run(0.5)
        assert sim.limits[0].velocity_max == pytest.approx(numbers(board.read("param.speed_limit"))[0] / 50.0)
    (refusal,) = sim.refusals
    assert f"acceleration of {JOINTS[0]} is above its limit 80 rad/s^2" in str(refusal), "4000 rad/s^2 of the motor"


def test_path_is_replaced_without_a_step(sim: PathSimulation) -> None:
    sim.follow(circle)
    sim.run(1.2)

    def back(running: Path, now: float) -> Path:
        state = running.state(now)
        assert np.abs(state.velocity).max() > 1.0
        return path_through(Waypoints.of(JOINTS, [now + 0.5], [[0.5, -0.5]]), state, now)

    sim.follow(back)
    sim.run(1.0)
    assert not sim.refusals
    assert not sim.errors
    table = sim.table()
    for joint, end in zip(JOINTS, (0.5, -0.5), strict=True):
        speed = np.diff(table[f"{joint}.position_ref"] * COUNT) / 0.5e-3
        assert np.abs(np.diff(speed)).max() * 2000.0 < 2.0 * COUNT / 0.5e-3**2 + 1000.0
        assert table[f"{joint}.position_ref"][-1] * COUNT == pytest.approx(end, abs=COUNT)


def test_crash_of_the_bridge_causes_a_controlled_stop(sim: PathSimulation) -> None:
    sim.follow(circle)
    sim.run(1.0)
    sim.writes_lost = True
    sim.run(1.0)
    table = sim.table()
    for joint in JOINTS:
        assert table[f"{joint}.limits"][-1] & 0x100
        assert table[f"{joint}.speed_ref"][-1] == 0
        assert not table[f"{joint}.faults"].any()


def test_every_stop_is_accepted_within_the_limits(sim: PathSimulation) -> None:
    def go(running: Path, now: float) -> Path:
        return moved(running, now, move(JOINTS, [0.0, 0.0], [60.0, -1.0], 2.0))

    def halt(running: Path, now: float) -> Path:
        return stop(JOINTS, running.state(now), [limit.acceleration_max for limit in sim.limits], now)

    for pause in (0.15, 0.2, 0.3):
        sim.follow(go)
        sim.run(pause)
        assert abs(sim.follower.running().state(sim.now).velocity).max() > 0.1
        sim.follow(halt)
        sim.run(0.3)
        assert not sim.errors
        table = sim.table()
        for joint in JOINTS:
            assert np.ptp(table[f"{joint}.position_ref"][-10:]) == 0
    assert not sim.refusals
