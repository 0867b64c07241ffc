"""Follower: start of paths, times of the sent points, replacement of paths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from servo_bridge.set_points import JointSetPoint
from servo_bridge.trajectory.check import Limits
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.follower import LEAD, AxisReport, Follower, PathEvents
from servo_bridge.trajectory.merge import merged
from servo_bridge.trajectory.path import Path, State
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.streamer import Streamer
from servo_bridge.trajectory.waypoints import Waypoints
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.joints import DEFAULT_JOINTS, Joint, joint_names
from servo_msgs_py.timed_points import TimedPoint, decode_points
from servo_msgs_py.units import PERIOD

CATALOGUE = Catalogue.load()
JOINTS = joint_names(DEFAULT_JOINTS)
SAMPLE = 160  # ticks between two samples


class Rig:
    """Follower with an ideal board that accepts and follows all points."""

    def __init__(self, joints: Sequence[Joint] = DEFAULT_JOINTS) -> None:
        self.refusals: list[str] = []
        self.ends: list[float] = []
        self.sent: list[TimedPoint] = []
        self.leads: list[int] = []  # lead of each point after the sample before it was sent [PWM periods]
        self.checked: list[Path] = []
        self.joints = joints
        self.follower = Follower(CATALOGUE, joints, self.checked.append, clock=lambda: self.time)
        self.on = PathEvents(self.ends.append, lambda error: self.refusals.append(str(error)))
        self.tick = 8000
        self.time = 0.0  # time of the host [s]
        self.references = [1.0, -2.0]
        self.follows = [True, True]

    def sample(self, count: int = 1, *, fetch: bool = True) -> None:
        for _ in range(count):
            self.tick += SAMPLE
            for axis, joint in enumerate(JOINTS):
                path = self.follower.paths().get(joint)
                if path is not None:
                    position = float(path.state(self.tick * PERIOD).position[0])
                    self.references[axis] = self.joints[axis].motor_position(position)
            reports = [AxisReport(*pair) for pair in zip(self.references, self.follows, strict=True)]
            self.follower.on_sample(self.tick, reports)
            words = self.follower.next_points() if fetch else None
            if words is not None:
                points = decode_points(CATALOGUE, words)
                self.follower.points_accepted({point.axis for point in points})
                self.sent += points
                self.leads += [point.tick - self.tick for point in points]

    def move(
        self,
        goal: list[float],
        seconds: float = 0.5,
        joints: list[str] | None = None,
        start: float = 0.0,
        size: int = 0,
    ) -> None:
        names = joints or JOINTS

        def plan(running: Path, now: float) -> Path:
            begin = max(now, start)
            waypoints = Waypoints.of(names, [begin + seconds], [goal])
            return path_through(waypoints, running.select(names).state(begin), begin)

        self.follower.request(names, plan, self.on, start=start, size=size)

    def of(self, axis: int) -> list[TimedPoint]:
        return [point for point in self.sent if point.axis == axis]


@pytest.fixture
def rig() -> Rig:
    rig = Rig()
    rig.sample(2)
    return rig


def test_a_path_begins_at_the_held_positions_and_ends_at_its_target(rig: Rig) -> None:
    rig.move([2.0, 2.0])
    rig.sample(75)
    (end,) = rig.ends
    for axis, (begin, goal) in enumerate(((1.0, 2.0), (-2.0, 2.0))):
        points = rig.of(axis)
        assert points[0].replaces
        assert not any(point.replaces for point in points[1:])
        assert points[0].position == pytest.approx(begin, abs=1e-6)
        assert points[-1].position == pytest.approx(goal, abs=1e-6)
        assert points[-1].velocity == 0.0
        assert points[-1].tick * PERIOD == pytest.approx(end, abs=PERIOD)
        assert all(a.tick < b.tick for a, b in pairwise(points))
    assert rig.of(0)[0].tick == rig.of(1)[0].tick
    assert rig.follower.axes == frozenset()


@pytest.mark.parametrize("goal", [[1.0, -2.0], [1.003, -2.0]])
def test_a_path_that_hardly_moves_ends(rig: Rig, goal: list[float]) -> None:
    rig.move(goal)
    rig.sample(75)
    assert len(rig.ends) == 1
    assert rig.follower.axes == frozenset()


def test_start_of_a_path_is_delayed_by_its_computing_time(rig: Rig) -> None:
    def plan(running: Path, now: float) -> Path:
        rig.time += 0.3
        waypoints = Waypoints.of(JOINTS, [now + 0.5], [[2.0, 2.0]])
        return path_through(waypoints, running.state(now), now)

    rig.follower.request(JOINTS, plan, rig.on)
    rig.tick += SAMPLE
    known = rig.tick * PERIOD
    for _ in range(3):
        rig.follower.on_sample(rig.tick, [AxisReport(place, follows=True) for place in rig.references])
    assert not rig.refusals
    begin = rig.follower.paths()["axis1"].start_time
    assert known + rig.time + 0.03 < begin < known + 5.0


def test_a_stream_whose_first_plan_is_late_begins_with_the_next_one(rig: Rig) -> None:
    delays = iter([0.3])

    def check(_: Path) -> None:
        rig.time += next(delays, 0.0)

    rig.follower = Follower(CATALOGUE, DEFAULT_JOINTS, check, clock=lambda: rig.time)
    rig.sample(2)
    streamer = Streamer(DEFAULT_JOINTS, rig.follower, 0.05)
    limits = [Limits(-math.inf, math.inf, 100.0, 1000.0, 1.0)] * 2
    for _ in range(80):
        streamer.take({0: JointSetPoint(1.0, 0.0)}, rig.follower.now, rig.follower.now, limits)
        rig.sample()
        streamer.advance(rig.follower.now)
    report = streamer.report
    assert report is not None
    assert report.received == 80
    assert rig.of(0)


def test_follower_waits_until_the_axes_follow_points_and_hold(rig: Rig) -> None:
    rig.follows = [True, False]
    rig.move([2.0, 2.0])
    rig.sample(5)
    assert not rig.sent
    assert rig.follower.axes == {0, 1}
    rig.follows = [True, True]
    for reference in (-1.9, -1.8):  # still moving
        rig.references[1] = reference
        rig.sample()
    assert not rig.sent
    rig.sample(2)
    assert rig.of(1)[0].position == pytest.approx(-1.8, abs=1e-6)


def test_points_are_sent_in_time_and_fit_the_queue(rig: Rig) -> None:
    rig.move([40.0, -40.0], seconds=4.0)
    worst = 0
    for _ in range(500):
        rig.sample()
        ahead = [sum(point.tick > rig.tick for point in rig.of(axis)) for axis in range(2)]
        worst = max(worst, *ahead)
    assert min(rig.leads) >= LEAD / PERIOD - 1
    assert 8 <= worst <= 14


def test_another_path_starts_with_the_state_of_the_first(rig: Rig) -> None:
    rig.move([3.0, 0.0], seconds=1.0)
    rig.sample(40)
    old = rig.follower.paths()["axis1"]
    known = len(rig.of(0))
    rig.move([-1.0, 0.0], seconds=1.0)
    rig.sample(3)
    new = rig.of(0)[known:]
    taken_over = next(point for point in new if point.replaces)
    time = taken_over.tick * PERIOD
    state = old.state(time)
    assert taken_over.position == pytest.approx(float(state.position[0]), abs=1e-6)
    assert taken_over.velocity == pytest.approx(float(state.velocity[0]), abs=1e-4)
    assert abs(taken_over.velocity) > 0.5
    assert time >= rig.tick * PERIOD - 3 * SAMPLE * PERIOD + LEAD - PERIOD


def test_the_other_joint_keeps_its_path(rig: Rig) -> None:
    rig.move([3.0, -3.0], seconds=1.0)
    rig.sample(20)
    rig.move([0.0], seconds=0.5, joints=["axis1"])
    rig.sample(120)
    assert rig.of(0)[-1].position == pytest.approx(0.0, abs=1e-6)
    assert rig.of(1)[-1].position == pytest.approx(-3.0, abs=1e-6)
    assert len(rig.ends) == 2


def test_a_path_with_a_later_start_waits_for_its_time(rig: Rig) -> None:
    start = rig.tick * PERIOD + 1.0
    rig.move([2.0, -2.0], start=start)
    rig.sample(55)
    assert not rig.sent
    rig.sample(115)
    assert rig.of(0)[0].tick * PERIOD == pytest.approx(start, abs=PERIOD)


@pytest.mark.parametrize("spacing", [20, 50, 400])
def test_distance_of_points_is_not_below_the_minimum_of_the_board(spacing: int) -> None:
    """For all positions of the first point among the points of the replaced path."""

    def plan(running: Path, now: float) -> Path:
        since = np.arange(1, 60) * spacing * PERIOD
        waypoints = Waypoints.of(["axis1"], now + since, 1.0 + np.sin(3.0 * since)[:, None])
        return path_through(waypoints, running.select(["axis1"]).state(now), now)

    for phase in range(0, spacing, 2):
        rig = Rig()
        rig.sample(2)
        rig.follower.request(["axis1"], plan, rig.on)
        rig.sample(3)
        rig.tick += phase
        rig.move([1.5], joints=["axis1"])
        rig.sample(30)
        assert not rig.refusals
        queue: list[int] = []
        for point in rig.of(0):
            if point.replaces:
                queue = [tick for tick in queue if tick < point.tick]
            queue.append(point.tick)
        assert min(np.diff(queue)) >= 16


def test_a_path_that_is_refused_at_its_begin_causes_no_motion(rig: Rig) -> None:
    def refuse(_: Path) -> None:
        raise ValueError("planted")

    rig.follower = Follower(CATALOGUE, DEFAULT_JOINTS, refuse)
    rig.sample(2)
    rig.move([2.0, 2.0])
    rig.sample(5)
    (refusal,) = rig.refusals
    assert "planted" in refusal
    assert not rig.sent
    assert rig.follower.axes == frozenset()


def test_a_path_that_is_refused_at_its_request_changes_nothing(rig: Rig) -> None:
    def refuse(path: Path) -> None:
        if path.duration < 0.1:
            raise TrajectoryError("too fast")

    rig.follower = Follower(CATALOGUE, DEFAULT_JOINTS, refuse)
    rig.sample(2)
    rig.move([2.0, 2.0], start=rig.tick * PERIOD + 1.0)
    with pytest.raises(TrajectoryError, match="too fast"):
        rig.move([3.0, 3.0], seconds=0.05, size=1)
    rig.sample(150)
    assert not rig.refusals
    assert rig.of(0)[-1].position == pytest.approx(2.0, abs=1e-6)


def test_a_cancelled_axis_gets_no_more_points(rig: Rig) -> None:
    rig.move([20.0, -20.0], seconds=3.0)
    rig.sample(5)
    rig.follower.cancel(0, "a set-point took over")
    known = len(rig.of(0))
    rig.sample(100)
    assert len(rig.of(0)) == known
    assert rig.of(1)[-1].tick > rig.tick - SAMPLE
    assert rig.follower.axes == {1}


def test_pending_request_is_notified_of_replacement_and_cancellation(rig: Rig) -> None:
    rig.follows = [False, False]
    rig.move([2.0, 2.0])
    rig.move([3.0, 3.0])
    assert len(rig.refusals) == 1
    rig.follower.cancel(1, "the link was lost")
    assert rig.refusals[1] == "the link was lost"


def test_pending_requests_of_different_joints_are_independent(rig: Rig) -> None:
    start = rig.tick * PERIOD + 1.0
    rig.move([2.0], joints=["axis1"], start=start)
    rig.move([0.0], joints=["axis2"])
    rig.sample(20)
    assert rig.of(1)
    assert not rig.of(0)
    rig.follower.cancel(1, "a set-point took over")
    rig.sample(160)
    assert not rig.refusals
    assert rig.of(0)[-1].position == pytest.approx(2.0, abs=1e-6)


def test_a_pending_request_outlives_the_end_of_the_path_before_it(rig: Rig) -> None:
    rig.move([3.0, 3.0], seconds=5.0)
    rig.sample(30)
    rig.move([2.0, 2.0], start=rig.tick * PERIOD + 1.0)
    for axis in range(2):
        rig.follower.end(axis, "cancelled")
    rig.sample(170)
    assert not rig.refusals
    assert rig.of(0)[-1].position == pytest.approx(2.0, abs=1e-6)


def test_efforts_become_currents() -> None:
    rig = Rig()
    rig.follower.torque_constants = [0.05, 0.05]
    rig.sample(2)

    def plan(_: Path, now: float) -> Path:
        return path_through(
            Waypoints.of(["axis1"], [now, now + 0.1], [[1.0], [1.0]], [[0.0], [0.0]], efforts=[[0.01], [0.02]])
        )

    rig.follower.request(["axis1"], plan, rig.on)
    rig.sample(20)
    assert not rig.refusals
    assert rig.of(0)[0].current == pytest.approx(0.2, abs=1e-3)
    assert rig.of(0)[-1].current == pytest.approx(0.4, abs=1e-3)


def test_points_of_a_geared_reversed_joint_are_those_of_its_motor() -> None:
    rig = Rig([Joint("axis1", 100.0, -1, 0.5), Joint("axis2")])
    rig.follower.torque_constants = [0.05, 0.05]
    rig.references = [-150.0, 2.0]
    rig.sample(2)
    assert rig.follower.running().state(rig.tick * PERIOD).position.tolist() == [2.0, 2.0]

    def plan(_: Path, now: float) -> Path:
        ends = [[2.0], [2.5]]
        rest = [[0.0], [0.0]]
        return path_through(Waypoints.of(["axis1"], [now, now + 1.0], ends, rest, rest, efforts=[[0.5], [0.5]]))

    rig.follower.request(["axis1"], plan, rig.on)
    rig.sample(150)
    assert not rig.refusals
    points = rig.of(0)
    assert (points[0].position, points[-1].position) == pytest.approx((-150.0, -200.0), abs=1e-6)
    assert points[-1].velocity == 0.0
    assert min(point.velocity for point in points) == pytest.approx(-100.0 * 1.875 * 0.5, rel=5e-2)
    assert points[0].current == pytest.approx(-0.1, abs=1e-3)
    # As many points as for the same motion of the motor, as the tolerance is that of the motor.
    motor = Rig()
    motor.move([51.0], joints=["axis1"], seconds=1.0)
    motor.sample(150)
    assert abs(len(points) - len(motor.of(0))) <= 1


# ---- first points that come too late --------------------------------------------------------------------------------


class Late:
    """Paths whose first points the board has refused because they came too late."""

    def __init__(
        self,
        joints: Sequence[str] = JOINTS,
        start: float = 0.0,
        goal: float = 2.0,
        times: Sequence[float] = (0.05,),
        goals: Sequence[Sequence[float]] = (),
    ) -> None:
        self.rig = Rig()
        self.rig.sample(2)
        self.leads: list[float] = []  # of each plan [s]
        self.abandoned: list[str] = []
        self.wanted = True  # the owner still needs the path

        def plan(running: Path, now: float) -> Path:
            self.leads.append(now - self.rig.tick * PERIOD)
            begin = max(now, start)
            waypoints = Waypoints.of(joints, [begin + time for time in times], goals or [[goal] * len(joints)])
            return path_through(waypoints, running.select(joints).state(begin), begin)

        self.rig.follower.request(
            joints,
            plan,
            replace(self.rig.on, abandoned=self.abandoned.append, postponed=lambda: self.wanted),
            start=start,
        )
        self.send()

    def send(self) -> None:
        """Take the first points from the follower; the board does not answer."""
        for _ in range(3):
            self.rig.sample(fetch=False)
        assert self.rig.follower.next_points() is not None

    def wait(self, seconds: float = 0.3) -> None:
        """Samples of joints that do not move."""
        for _ in range(round(seconds / PERIOD) // SAMPLE):
            self.rig.tick += SAMPLE
            reports = [AxisReport(reference, follows=True) for reference in (1.0, -2.0)]
            self.rig.follower.on_sample(self.rig.tick, reports)


def test_path_is_planned_again_with_a_longer_lead_twice() -> None:
    late = Late()
    for _ in range(2):
        late.wait(1.0)
        assert late.rig.follower.postpone([0, 1])
        late.wait(0.03)
        assert late.rig.follower.next_points() is not None
    late.wait(1.0)
    assert not late.rig.follower.postpone([0, 1])
    assert late.leads == pytest.approx([LEAD, 3 * LEAD, 9 * LEAD], abs=0.02)
    assert len(late.rig.ends) == 3
    assert not late.abandoned


def test_path_of_one_write_is_repeated_although_its_end_has_passed() -> None:
    late = Late(["axis1"], goal=1.0)
    assert late.rig.follower.next_points() is None
    late.wait(1.0)
    assert late.rig.follower.postpone([0])


def test_path_is_not_repeated_if_its_points_came_in_time() -> None:
    """The board has refused them for another reason."""
    late = Late()
    assert not late.rig.follower.postpone([0, 1])


def test_path_is_not_repeated_after_its_joints_have_moved() -> None:
    late = Late()
    late.rig.follower.points_accepted([0])
    late.wait()
    assert not late.rig.follower.postpone([1])


def test_path_is_not_repeated_if_its_joints_are_back_at_its_begin() -> None:
    times = [0.002 * k for k in range(1, 40)] + [1.0]
    late = Late(["axis1"], times=times, goals=[*([1.01 if k == 2 else 1.0] for k in range(1, 40)), [2.0]])
    late.rig.follower.points_accepted([0])
    late.wait()
    assert late.rig.follower.next_points() is not None
    assert not late.rig.follower.postpone([0])


def test_path_whose_second_write_comes_too_late_is_repeated_from_its_begin() -> None:
    """The segments of its begin are so short that the shaft has hardly moved with the points of the first write."""
    times = [0.002 * k for k in range(1, 40)] + [1.0]
    late = Late(["axis1"], times=times, goals=[*([1.0 + 0.001 * (k % 2)] for k in range(1, 40)), [2.0]])
    late.rig.follower.points_accepted([0])
    late.wait(0.3)
    assert late.rig.follower.next_points() is not None
    assert late.rig.follower.postpone([0])
    late.wait(0.03)
    assert late.rig.follower.next_points() is not None
    assert len(late.rig.ends) == 2
    assert not late.abandoned


def test_path_with_a_start_time_is_not_repeated() -> None:
    late = Late(start=(8000 + 3 * SAMPLE) * PERIOD + 0.1)
    late.wait()
    assert not late.rig.follower.postpone([0, 1])


def test_path_is_not_repeated_if_another_command_has_taken_one_of_its_joints() -> None:
    late = Late()
    late.wait()
    late.rig.follower.cancel(0, "a set-point took over")
    assert late.abandoned == ["a set-point took over"]
    assert not late.rig.follower.postpone([1])


def test_path_is_not_repeated_while_another_one_waits() -> None:
    late = Late()
    late.wait()
    late.rig.move([0.0], joints=["axis2"], start=1e3)
    assert not late.rig.follower.postpone([0, 1])


def test_path_is_not_repeated_if_its_owner_does_not_need_it() -> None:
    late = Late()
    late.wait()
    late.wanted = False
    assert not late.rig.follower.postpone([0, 1])
    late.wait()
    assert len(late.leads) == 1


@pytest.mark.parametrize("axis", [0, 1])
def test_cancelling_a_joint_ends_a_postponed_path_of_both(axis: int) -> None:
    late = Late()
    late.wait()
    assert late.rig.follower.postpone([0, 1])
    late.rig.follower.cancel(axis, "the axes were disabled")
    assert late.rig.refusals == ["the axes were disabled"]
    late.wait()
    assert late.rig.follower.next_points() is None
    assert late.rig.follower.axes == frozenset()


def test_merged_paths_are_the_same_motions() -> None:
    a = path_through(Waypoints.of(["a"], [1.0, 2.0, 4.0], [[0.0], [1.0], [-1.0]]))
    b = path_through(
        Waypoints.of(["b"], [1.5, 3.5], [[2.0], [5.0]], [[0.0], [0.0]], [[1.0], [-1.0]]), State.at_rest([2.0]), 1.5
    )
    both = merged([a, b])
    t = np.linspace(0.0, 5.0, 1001)
    for joint, path in (("a", a), ("b", b)):
        mine, other = both.select([joint]).state(t), path.state(t)
        assert np.abs(mine.position - other.position).max() < 1e-12
        assert np.abs(mine.velocity - other.velocity).max() < 1e-10
