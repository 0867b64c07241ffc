"""No shaft moves without a command: sequences of commands of a user and of ros2_control, in simulated time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import pytest
from bench import stream_delay
from command_sequences import EVENTS, GOAL_ERROR, LIMIT, SETUP_VALUES, STEP_VALUES, CommandSequence, Kind, Setup, Step
from controllers.controllers import SUCCESSFUL
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

SETUPS = st.builds(Setup, **{name: st.sampled_from(values) for name, values in SETUP_VALUES.items()})
STEPS = st.builds(
    Step, st.sampled_from(EVENTS), **{name: st.sampled_from(values) for name, values in STEP_VALUES.items()}
)

CASES = {
    "hardware active again, joint moved elsewhere": (
        Setup(),
        [Step("deactivate"), Step("move", 1.5, distance=2.0), Step("activate", controller="")],
    ),
    "hardware and controller active again, joint moved elsewhere": (
        Setup(),
        [Step("deactivate"), Step("move", 1.5, distance=2.0), Step("activate"), Step("goal")],
    ),
    "hardware that sends 0 started at an enabled joint": (
        Setup(old_plugin=True, running=False),
        [Step("enable"), Step("move", 1.5), Step("activate", controller="")],
    ),
    "board restarted under a controller that starts at its last command": (
        Setup(interpolate_from_desired_state=True, tolerances="none"),
        [Step("board restart", 1.0), Step("enable"), Step("goal", 1.5)],
    ),
    "goal beyond a limit, and back": (
        Setup(joints="limited"),
        [Step("goal", 1.5, distance=4.0, time=1.0), Step("goal", 1.5, distance=-0.5)],
    ),
    "velocity towards a limit": (
        Setup(joints="limited"),
        [Step("activate", controller="velocity"), Step("goal", 2.0, distance=8.0, time=1.0), Step("activate")],
    ),
    "no bytes for 0.25 s during a goal": (
        Setup(),
        [Step("goal", 0.6, distance=4.0, time=2.0), Step("stall", 2.0, time=0.25)],
    ),
    "goal of several turns": (
        Setup(interpolate_from_desired_state=True),
        [Step("goal", 2.5, distance=6.28, time=2.0)],
    ),
    "velocity that its controller has left behind": (
        Setup(),
        [
            Step("activate", controller="velocity"),
            Step("goal", 1.0, distance=2.0, time=1.0),
            Step("deactivate"),
            Step("activate", controller=""),
        ],
    ),
    "position controller after a trajectory controller": (
        Setup(),
        [Step("activate", controller="position"), Step("goal", 1.0), Step("goal", 1.0, distance=-2.0)],
    ),
    "stop and enable during a goal": (
        Setup(tolerances="none"),
        [Step("goal", 0.2, time=1.2), Step("quick stop", 0.3), Step("enable", 1.0)],
    ),
}


@pytest.mark.parametrize(("setup", "steps"), CASES.values(), ids=CASES)
def test_known_danger(setup: Setup, steps: Sequence[Step]) -> None:
    sequence = CommandSequence(setup, steps)
    assert not sequence.run(), sequence.log


@pytest.mark.parametrize("baud", [1_000_000, 115_200])
@pytest.mark.parametrize("rate", [50.0, 100.0, 500.0])
@pytest.mark.parametrize(("gear_ratio", "direction"), [(1.0, 1), (3.0, -1)])
def test_goals_are_reached(baud: int, rate: float, gear_ratio: float, direction: int) -> None:
    setup = Setup(rate, baud=baud, gear_ratio=gear_ratio, direction=direction)
    goals = [Step("goal", 1.2, distance=3.0), Step("goal", 1.2, distance=-3.0, velocities=True)]
    sequence = CommandSequence(setup, goals)
    violations, results = sequence.run(), sequence.results
    assert not violations, sequence.log
    assert results == [SUCCESSFUL] * 3


@pytest.mark.parametrize(("baud", "delay"), [(115_200, 0.052), (1_000_000, 0.043)])
def test_delay_of_a_stream_is_that_of_the_document(baud: int, delay: float) -> None:
    """At 100 Hz; the lag is the one from which the tolerance of ros2_controllers.yaml is calculated."""
    measured = stream_delay.measure(baud, 100.0)
    assert measured.delay < delay
    assert measured.lag < 0.1
    assert measured.stamp_error < 1e-3


def test_a_goal_beyond_a_limit_is_refused_in_one_line() -> None:
    sequence = CommandSequence(Setup(joints="limited"), [Step("goal", 1.5, distance=4.0, time=1.0)])
    assert not sequence.run(), sequence.log
    lines = [line for line in sequence.log if "rejected, no motion" in line and "outside -3 .. 3 rad" in line]
    assert len(lines) == 1


@pytest.mark.parametrize(("baud", "gear_ratio"), [(1_000_000, 3.0), (115_200, 1.0)])
def test_a_velocity_is_stopped_shortly_before_a_limit(baud: int, gear_ratio: float) -> None:
    """At 10 rad/s: 20 ms for the computer, an interval of the samples, and the line."""
    steps = [Step("activate", controller="velocity"), Step("goal", distance=10.0, time=1.0)]
    sequence = CommandSequence(Setup(joints="limited", baud=baud, gear_ratio=gear_ratio), steps)
    assert not sequence.run(), sequence.log
    first, second = sequence.places[-1]
    assert min(first, -second) > LIMIT - 0.42
    assert max(first, -second) < LIMIT


def moved(sequence: CommandSequence) -> list[tuple[float, ...]]:
    """Distances of each step [rad]."""
    return [tuple(b - a for a, b in zip(*pair, strict=True)) for pair in pairwise(sequence.places)]


@pytest.mark.parametrize("running", [True, False])
def test_velocity_controller_turns_the_joint_until_a_trajectory_controller_succeeds_it(running: bool) -> None:
    steps = [
        Step("activate", controller="velocity"),
        Step("enable"),
        Step("goal", 2.0, distance=6.0, time=2.0),
        Step("activate"),
        Step("goal", 1.5),
    ]
    sequence = CommandSequence(Setup(running=running), steps)
    assert not sequence.run(), sequence.log
    _, _, turned, stopped, goal = moved(sequence)
    assert turned == pytest.approx((6.0, -6.0), abs=0.8)
    assert max(map(abs, stopped)) < 0.3, "less than 0.1 s"
    assert goal == pytest.approx((1.0, -1.0), abs=GOAL_ERROR)


@pytest.mark.parametrize("controller", ["trajectory", "position"])
def test_a_velocity_controller_of_one_joint_beside_another_one_of_the_other(controller: Kind) -> None:
    """Both renew their set-points more often than the line carries."""
    steps = [Step("activate", controller=controller, second="velocity"), Step("goal", 1.5, distance=2.0, time=1.0)]
    sequence = CommandSequence(Setup(separate=True, baud=115_200), steps)
    assert not sequence.run(), sequence.log
    first, second = moved(sequence)[-1]
    assert first == pytest.approx(2.0, abs=GOAL_ERROR)
    assert second == pytest.approx(-3.0, abs=0.3)


def test_position_controller_after_a_velocity_controller() -> None:
    """The velocity stays in the messages."""
    steps = [
        Step("activate", controller="velocity"),
        Step("goal", 0.5, distance=2.0, time=1.0),
        Step("activate", 0.1, controller="position"),
        Step("goal", 1.5),
    ]
    sequence = CommandSequence(Setup(), steps)
    assert not sequence.run(), sequence.log
    assert moved(sequence)[-1] == pytest.approx((1.0, -1.0), abs=GOAL_ERROR)


@pytest.mark.parametrize(("controller", "way"), [("trajectory", 1.0), ("velocity", 1.0), ("position", 40.0)])
def test_a_fault_of_one_joint_stops_the_other_one_of_the_same_message(controller: Kind, way: float) -> None:
    """At 15 rad/s, as a position at 300 rad/s."""
    steps = [
        Step("activate", controller=controller),
        Step("goal", 0.15, distance=60.0, time=4.0),
        Step("fault", 0.5),
        Step("goal", 0.5, distance=1.0),
    ]
    sequence = CommandSequence(Setup(), steps)
    assert not sequence.run(), sequence.log
    _, _, stopped, refused = moved(sequence)
    assert abs(stopped[1]) < way
    assert refused[1] == pytest.approx(0.0, abs=0.02)
    line = next(line for line in sequence.log if "axis1 is in FAULT" in line)
    assert "axis2 of the same message stops, too" in line


def test_move_beside_an_active_controller_is_carried_out_and_its_next_goal_too() -> None:
    sequence = CommandSequence(Setup(), [Step("move", 1.5, distance=2.0), Step("goal", 1.5)])
    assert not sequence.run(), sequence.log
    assert moved(sequence) == [pytest.approx(each, abs=GOAL_ERROR) for each in ([-2.0, 2.0], [1.0, -1.0])]
    assert sequence.results == [SUCCESSFUL] * 2
    refusals = [line for line in sequence.log if "rejected, no motion" in line]
    assert len(refusals) <= 4, refusals


def test_move_beside_a_preferred_stream_is_refused_until_the_hardware_is_inactive() -> None:
    steps = [Step("move", 1.3), Step("deactivate", 1.3), Step("move", 1.3)]
    sequence = CommandSequence(Setup(preferred_source="joint_commands"), steps)
    assert not sequence.run(), sequence.log
    assert moved(sequence) == [pytest.approx(each, abs=GOAL_ERROR) for each in ([0, 0], [0, 0], [-1, 1])]
    (refusal,) = (line for line in sequence.log if "joint_trajectory: joint_commands commands" in line)
    assert "make the hardware inactive" in refusal


def test_a_refused_trajectory_does_not_stop_a_stream() -> None:
    steps = [Step("goal", 0.3, distance=3.0, time=1.0), Step("move", 1.5, distance=100.0, time=0.01)]
    sequence = CommandSequence(Setup(), steps)
    assert not sequence.run(), sequence.log
    assert sequence.results == [SUCCESSFUL] * 2


def test_motion_without_a_command_is_found() -> None:
    violations = CommandSequence(Setup(), [Step("stranger", distance=0.5)]).run()
    assert [violation.axis for violation in violations] == [0]


@given(SETUPS, st.lists(STEPS, min_size=4, max_size=4))
@settings(
    max_examples=50,
    derandomize=True,
    database=None,
    deadline=None,
    phases=[Phase.generate, Phase.shrink],
    suppress_health_check=[HealthCheck.too_slow],
)
def test_no_motion_without_a_command(setup: Setup, steps: Sequence[Step]) -> None:
    sequence = CommandSequence(setup, steps)
    assert not sequence.run(), sequence.log
