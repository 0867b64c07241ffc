"""The model of ros2_control (`controllers`): messages of the hardware, references of the controllers."""

from __future__ import annotations

import math

import pytest
from controllers.controllers import (
    CANCELED,
    GOAL_TOLERANCE_VIOLATED,
    INVALID_GOAL,
    PATH_TOLERANCE_VIOLATED,
    SUCCESSFUL,
    Constraints,
    ForwardController,
    JointTrajectoryController,
)
from controllers.hardware import CURRENT_PLUGIN, OLD_PLUGIN, POSITION, VELOCITY, Plugin, StateMessage, TopicHardware
from controllers.manager import ControllerManager
from controllers.trajectory import Point, Trajectory, wrapped_near

JOINTS = ("a", "b")
RATE = 100.0


def hardware(plugin: Plugin = CURRENT_PLUGIN) -> TopicHardware:
    return TopicHardware(JOINTS, dict.fromkeys(JOINTS, (POSITION, VELOCITY)), plugin)


class End:
    """A controller_manager whose joints follow their commands exactly, unless they are `stuck`."""

    def __init__(self, plugin: Plugin = CURRENT_PLUGIN, at: tuple[float, ...] = (0.5, -0.5), **options: object) -> None:
        self.hardware = hardware(plugin)
        self.trajectory = JointTrajectoryController(JOINTS, RATE, **options)  # type: ignore[arg-type]
        self.velocity = ForwardController(JOINTS, VELOCITY)
        self.manager = ControllerManager(self.hardware, [self.trajectory, self.velocity], RATE)
        self.at, self.stuck, self.time = at, False, 10.0
        self.sent: list[tuple[tuple[float, ...], tuple[float, ...]]] = []
        self.receive((0.0, 0.0))

    def receive(self, speeds: tuple[float, ...]) -> None:
        self.hardware.receive(StateMessage(JOINTS, self.at, speeds))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * RATE)):
            message = self.manager.cycle(self.time)
            self.time += 1.0 / RATE
            if message is not None:
                self.sent.append((message.positions, message.velocities))
                if not self.stuck and not any(map(math.isnan, message.positions)):
                    self.at = message.positions
                    self.receive(message.velocities)

    def start(self) -> None:
        self.run(0.05)
        self.manager.switch(start=self.trajectory)


@pytest.mark.parametrize(("plugin", "value"), [(CURRENT_PLUGIN, math.nan), (OLD_PLUGIN, 0.0)])
def test_hardware_sends_all_joints_before_a_controller_has_started(plugin: Plugin, value: float) -> None:
    end = End(plugin)
    end.stuck = True
    end.run(0.02)
    assert len(end.sent) == 2
    for array in end.sent[0]:
        assert array == pytest.approx((value, value), nan_ok=True)


def test_hardware_is_silent_while_states_and_commands_agree() -> None:
    end = End()
    end.start()
    end.run(0.1)
    end.sent.clear()
    end.run(0.1)
    assert end.sent == []
    end.at = (0.5, -0.5 + 1.1e-5)
    end.receive((0.0, 0.0))
    end.run(0.01)
    assert end.sent == [((0.5, -0.5), (0.0, 0.0))]


def test_released_and_inactive_hardware_keeps_its_last_command() -> None:
    end = End()
    end.start()
    end.trajectory.goal([Point((2.0, -2.0), time=0.2)])
    end.run(0.5)
    end.manager.switch(stop=end.trajectory)
    end.manager.set_hardware_active(False)
    end.sent.clear()
    end.at, end.stuck = (7.0, 7.0), True
    end.receive((0.0, 0.0))
    end.run(0.1)
    assert end.sent == []
    end.manager.set_hardware_active(True)
    end.run(0.02)
    assert end.sent == [((2.0, -2.0), (0.0, 0.0))] * 2


def test_controller_started_again_holds_the_last_command() -> None:
    end = End()
    end.start()
    end.run(0.1)
    end.manager.switch(stop=end.trajectory)
    end.at, end.stuck = (3.0, 3.0), True
    end.receive((0.0, 0.0))
    end.run(0.05)
    end.manager.switch(start=end.trajectory)
    end.run(0.05)
    assert end.sent[-1] == ((0.5, -0.5), (0.0, 0.0))


@pytest.mark.parametrize(
    ("velocities", "accelerations", "middle"),
    [((), (), 0.5), ((0.0, 0.0), (), 0.5), ((0.0, 0.0), (0.0, 0.0), 0.5)],
    ids=["linear", "cubic", "quintic"],
)
def test_spline_depends_on_what_both_ends_contain(
    velocities: tuple[float, ...], accelerations: tuple[float, ...], middle: float
) -> None:
    trajectory = Trajectory([Point((1.0, -1.0), velocities, accelerations, 1.0)])
    trajectory.set_start(0.0, Point((0.0, 0.0), (0.0, 0.0)), [False, False])
    samples = [trajectory.sample(time) for time in (0.0, 0.25, 0.5, 1.0, 5.0)]
    assert all(sample is not None for sample in samples)
    positions = [sample.state.positions[0] for sample in samples if sample is not None]
    quarter = 0.25 if not velocities else 0.15625 if not accelerations else 0.103515625
    assert positions == pytest.approx([0.0, quarter, middle, 1.0, 1.0])
    assert [sample.finished for sample in samples if sample is not None] == [False, False, False, True, True]


def test_trajectory_with_several_points_passes_through_them() -> None:
    points = [Point((1.0,), (2.0,), (1.0,), 1.0), Point((0.0,), (0.0,), (0.0,), 2.0)]
    trajectory = Trajectory(points)
    trajectory.set_start(0.0, Point((0.0,), (0.0,)), [False])
    trajectory.sample(0.0)
    sample = trajectory.sample(1.0)
    assert sample is not None
    assert (sample.state.positions, sample.state.velocities, sample.state.accelerations) == ((1.0,), (2.0,), (1.0,))


@pytest.mark.parametrize(
    ("position", "target", "wrapped"),
    [(0.0, 6.28, 2 * math.pi), (0.0, 3.0, 0.0), (10.0, 0.0, 10.0 - 4 * math.pi), (0.0, math.pi, 0.0)],
)
def test_continuous_joint_starts_within_half_a_turn_of_the_first_point(
    position: float, target: float, wrapped: float
) -> None:
    assert wrapped_near(position, target) == pytest.approx(wrapped)
    end = End(at=(position, position), continuous=JOINTS)
    end.start()
    end.run(0.05)
    end.trajectory.goal([Point((target, target), time=1.0)])
    end.run(0.01)
    assert end.sent[-1][0][0] == pytest.approx(wrapped + 0.01 * (target - wrapped))


@pytest.mark.parametrize("desired", [False, True])
def test_new_goal_starts_at_the_state_or_at_the_last_command(desired: bool) -> None:
    end = End(interpolate_from_desired_state=desired)
    end.start()
    end.run(0.1)
    end.stuck, end.at = True, (1.5, -0.5)
    end.receive((0.0, 0.0))
    end.run(0.05)
    end.trajectory.goal([Point((2.0, -0.5), (0.0, 0.0), (), 10.0)])
    end.run(0.02)
    assert end.sent[-1][0][0] == pytest.approx(0.5 if desired else 1.5, abs=1e-3)


def test_goal_for_one_joint_holds_the_command_of_the_other_one() -> None:
    end = End()
    end.start()
    end.run(0.1)
    end.trajectory.goal({"b": [Point((1.0,), (0.0,), (), 0.1)]})
    end.run(0.3)
    assert end.at == pytest.approx((0.5, 1.0))
    assert end.trajectory.results == [SUCCESSFUL]


def test_results_of_goals() -> None:
    end = End(constraints=Constraints(0.3, 0.02, 0.1, 0.5))
    assert not end.trajectory.goal([Point((1.0, 1.0), time=1.0)])
    end.start()
    end.run(0.05)
    goal = [Point((2.5, 1.5), (0.0, 0.0), (), 1.0)]
    end.trajectory.goal(goal)
    end.run(0.3)
    end.trajectory.goal(goal)  # replaces the first one
    end.run(0.3)
    end.trajectory.cancel()
    end.run(0.05)
    held = end.at
    end.trajectory.goal(goal)
    end.stuck = True
    end.run(0.6)
    assert [end.hardware.commands[joint, POSITION] for joint in JOINTS] == pytest.approx(held)  # holds the place
    end.stuck = False
    end.trajectory.goal([Point((held[0] + 0.1, held[1]), (0.0, 0.0), (), 0.1)])
    end.stuck = True
    end.run(0.5)
    assert end.trajectory.results == [INVALID_GOAL, CANCELED, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED]
    end.trajectory.goal(goal)
    end.manager.switch(stop=end.trajectory)
    assert end.trajectory.results[-1] == INVALID_GOAL


def test_forward_controller_leaves_the_other_interface_as_it_is() -> None:
    end = End()
    end.start()
    end.run(0.1)
    end.stuck = True
    end.manager.switch(start=end.velocity, stop=end.trajectory)
    end.run(0.05)
    end.velocity.command((2.0, -2.0))
    end.run(0.05)
    assert end.sent[-1] == ((0.5, -0.5), (2.0, -2.0))
    end.manager.switch(stop=end.velocity)
    end.run(0.05)
    assert end.sent[-1] == ((0.5, -0.5), (2.0, -2.0))


def test_new_process_of_the_manager_has_forgotten_its_commands() -> None:
    end = End()
    end.start()
    end.run(0.1)
    again = End()
    again.run(0.01)
    assert all(math.isnan(value) for array in again.sent[-1] for value in array)
