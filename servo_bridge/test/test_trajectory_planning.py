"""Planning of long paths in another thread, bounds, and paths that the line does not carry."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from types import SimpleNamespace
from typing import TypeVar

import numpy as np
import pytest
from servo_bridge.set_points import JointSetPoint
from servo_bridge.trajectory.check import Limits
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.follower import QUICK, AxisReport, Follower, PathEvents
from servo_bridge.trajectory.line_capacity import PointLine
from servo_bridge.trajectory.message import TrajectoryMessage, check_size, converted
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.streamer import Streamer
from servo_bridge.trajectory.waypoints import DURATION_MAX, WAYPOINTS_MAX, Waypoints
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import DEFAULT_JOINTS, joint_names
from servo_msgs_py.timed_points import decode_points
from servo_msgs_py.units import PERIOD

CATALOGUE = Catalogue.load()
JOINTS = joint_names(DEFAULT_JOINTS)
SAMPLE = 160  # ticks between two samples
T = TypeVar("T")


class Rig:
    """Follower of a resting board whose long plannings wait until the test runs them."""

    def __init__(self, line: PointLine | None = None) -> None:
        self.works: list[Callable[[], None]] = []
        self.refusals: list[str] = []
        self.ends: list[float] = []
        self.on = PathEvents(self.ends.append, lambda error: self.refusals.append(str(error)))
        self.time = 0.0  # s
        self.tick = 8000
        self.references = [0.0, 0.0]
        self.follower = Follower(
            CATALOGUE, DEFAULT_JOINTS, lambda _: None, clock=lambda: self.time, work=self._work, line=lambda: line
        )
        self.sample(3)

    def _work(self, work: Callable[[], T], done: Callable[[Future[T]], None]) -> None:
        def run() -> None:
            future: Future[T] = Future()
            try:
                future.set_result(work())
            except Exception as error:
                future.set_exception(error)
            done(future)

        self.works.append(run)

    def sample(self, count: int = 1) -> None:
        for _ in range(count):
            self.tick += SAMPLE
            self.time += SAMPLE * PERIOD
            self.follower.on_sample(self.tick, [AxisReport(place, follows=True) for place in self.references])

    @property
    def now(self) -> float:
        """Board time [s]."""
        return self.tick * PERIOD

    def follow(self, count: int, rate: float = 100.0, noise: float = 0.0, joints: Sequence[str] = JOINTS) -> None:
        """Request a path of many waypoints."""

        def plan(running: Path, now: float) -> Path:
            t = np.arange(1, count + 1) / rate
            rows = np.stack((1.0 - np.cos(t), np.cos(t) - 1.0)[: len(joints)], axis=1)
            rows += noise * np.random.default_rng(1).standard_normal(rows.shape)
            return path_through(Waypoints.of(joints, now + t, rows), running.select(joints).state(now), now)

        self.follower.request(joints, plan, self.on, size=count, movable=True)


def test_long_path_is_planned_beside_the_samples_and_moved_to_its_start() -> None:
    rig = Rig()
    rig.follow(2000)
    assert rig.follower.axes == frozenset()  # nothing changes until it has been checked
    assert rig.follower.claimed == {0, 1}
    rig.works.pop(0)()
    rig.sample(2)
    assert rig.follower.axes == {0, 1}
    assert not rig.ends
    rig.sample(60)  # 0.6 s pass during the planning
    rig.works.pop(0)()
    assert not rig.works
    (end,) = rig.ends
    start = rig.follower.paths()["axis1"].start_time
    assert 0.09 < start - rig.follower.now < 0.2
    assert end == pytest.approx(start + 20.0, abs=0.01)
    words = rig.follower.next_points()
    assert words is not None
    assert decode_points(CATALOGUE, words)[0].tick == pytest.approx(start / PERIOD, abs=1)


def test_short_path_is_planned_at_once() -> None:
    rig = Rig()
    rig.follow(QUICK)
    rig.sample()
    assert not rig.works
    assert rig.ends


@pytest.mark.parametrize("after", [0, 1])
def test_command_during_the_planning_cancels_the_path(after: int) -> None:
    rig = Rig()
    rig.follow(1000)
    for _ in range(after):
        rig.works.pop(0)()
        rig.sample()
    rig.follower.cancel(0, "a set-point took over")
    for work in rig.works:
        work()
    assert rig.refusals == ["a set-point took over"]
    assert not rig.ends
    assert rig.follower.claimed == frozenset()


def test_path_is_planned_again_if_a_joint_has_moved_meanwhile() -> None:
    rig = Rig()
    rig.follow(1000)
    rig.works.pop(0)()
    rig.sample()
    rig.references = [0.5, 0.0]
    rig.sample(2)
    rig.works.pop(0)()
    assert not rig.ends
    rig.sample()
    rig.works.pop(0)()
    assert rig.ends
    assert rig.follower.paths()["axis1"].coefficients[0, 0, 0] == pytest.approx(0.5, abs=1e-6)


def test_path_of_a_joint_that_moves_during_every_planning_is_refused() -> None:
    rig = Rig()
    rig.follow(1000)
    rig.works.pop(0)()
    for k in range(1, 5):
        rig.sample(2)
        rig.references = [0.1 * k, 0.0]
        rig.sample()
        rig.works.pop(0)()
    assert rig.refusals == ["its joints moved while it was planned; stop them first"]


def test_path_of_moving_joints_is_refused_if_its_start_passes_while_it_is_planned() -> None:
    rig = Rig()
    rig.follow(QUICK, 10.0)
    rig.sample()
    rig.follow(1000)
    rig.works.pop(0)()
    for seconds in (3.0, 8.0):
        rig.sample()
        assert not rig.refusals
        rig.sample(round(seconds / (SAMPLE * PERIOD)))
        rig.works.pop(0)()
    (refusal,) = rig.refusals
    assert "its planning takes 8.0 s" in refusal
    assert len(rig.ends) == 1


def test_replaced_path_is_not_planned() -> None:
    rig = Rig()
    planned: list[int] = []

    def plan(_running: Path, _now: float) -> Path:
        planned.append(1)
        raise TrajectoryError("planted")

    rig.follower.request(JOINTS, plan, rig.on, size=QUICK + 1)
    rig.follow(QUICK)
    rig.works.pop(0)()
    assert not planned
    assert len(rig.refusals) == 1


def test_error_of_a_long_path_is_its_refusal() -> None:
    rig = Rig()

    def fail(_running: Path, _now: float) -> Path:
        raise ValueError("planted")

    rig.follower.request(JOINTS, fail, rig.on, size=QUICK + 1)
    rig.works.pop(0)()
    assert "planted" in rig.refusals[0]


@pytest.mark.parametrize("rate", [50.0, 125.0, 250.0])
def test_smooth_path_of_any_rate_is_carried_by_a_slow_line(rate: float) -> None:
    rig = Rig(PointLine(0.5, "a slow line"))  # 16 points/s
    rig.follow(round(4 * rate), rate)
    while not (rig.ends or rig.refusals):
        rig.sample()
        while rig.works:
            rig.works.pop(0)()
    assert not rig.refusals
    start = rig.follower.paths()["axis1"].start_time
    assert start - rig.follower.now > 0.5  # the first write takes as long


def test_path_that_the_line_does_not_carry_is_refused_with_both_rates() -> None:
    rig = Rig(PointLine(0.04, "115200 baud"))
    rig.follow(200, 150.0, noise=0.01)
    while not (rig.ends or rig.refusals):
        rig.works.pop(0)()
        rig.sample()
    (refusal,) = rig.refusals
    assert "the line carries 200 at 115200 baud" in refusal
    assert "the path needs 29" in refusal  # 300 points/s of both joints
    assert not rig.ends


@pytest.mark.parametrize("carried", [True, False])
@pytest.mark.parametrize("path_first", [True, False])
def test_a_stream_and_the_path_of_another_joint_share_the_line(carried: bool, path_first: bool) -> None:
    line = PointLine(
        0.032 if carried else 0.04, "115200 baud"
    )  # 250 or 200 points/s: 150 of the path, 100 of the stream
    rig = Rig(line)
    limits = Limits(-100.0, 100.0, 400.0, 4000.0, 1.0)
    streamer = Streamer(DEFAULT_JOINTS, rig.follower, 0.06, line=lambda: line)
    refused: list[str] = []

    def begin_stream() -> None:
        try:
            streamer.require_carried("joint_commands", [1])
        except TrajectoryError as error:
            refused.append(str(error))
            return
        streamer.take({1: JointSetPoint(0.0, 0.1)}, rig.now, rig.now, [limits] * 2)
        rig.sample()

    if not path_first:
        begin_stream()
    rig.follow(300, 150.0, noise=0.01, joints=("axis1",))
    while not (rig.ends or rig.refusals):
        while rig.works:
            rig.works.pop(0)()
        rig.sample()
    if path_first:
        begin_stream()
    reasons = rig.refusals + refused
    assert len(reasons) == (not carried)
    assert all(
        "100 points/s of the board beside 1" in each or "the stream of the other joint need" in each for each in reasons
    )


def message(joints: int, points: int) -> TrajectoryMessage:
    header = SimpleNamespace(frame_id="", stamp=SimpleNamespace(sec=0, nanosec=0))
    return converted(SimpleNamespace(header=header, joint_names=["axis1"] * joints, points=[None] * points))


@pytest.mark.parametrize(
    ("joints", "points", "bound"), [(2, WAYPOINTS_MAX + 1, WAYPOINTS_MAX), (3, 2, 2), (10**6, 1, 2)]
)
def test_size_of_a_message_is_bounded_before_any_work(joints: int, points: int, bound: int) -> None:
    check_size(message(2, WAYPOINTS_MAX), "a topic")
    with pytest.raises(TrajectoryError, match=f"more than {bound}; send at most {bound}"):
        check_size(message(joints, points), "a topic")


def test_number_and_duration_of_waypoints_are_bounded() -> None:
    Waypoints.of(["axis1"], np.arange(1, WAYPOINTS_MAX + 1), np.zeros((WAYPOINTS_MAX, 1)))
    with pytest.raises(TrajectoryError, match=f"more than {WAYPOINTS_MAX}"):
        Waypoints.of(["axis1"], np.arange(WAYPOINTS_MAX + 1), np.zeros((WAYPOINTS_MAX + 1, 1)))
    with pytest.raises(TrajectoryError, match=f"more than {DURATION_MAX:g} s"):
        Waypoints.of(["axis1"], [0.0, math.nextafter(DURATION_MAX, math.inf)], np.zeros((2, 1)))
    start = State.at_rest(np.zeros(1))
    with pytest.raises(TrajectoryError, match=f"more than {DURATION_MAX:g} s"):  # also a single waypoint
        path_through(Waypoints.of(["axis1"], [math.nextafter(DURATION_MAX, math.inf)], np.zeros((1, 1))), start)
