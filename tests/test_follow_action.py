"""Goals of ``follow_joint_trajectory`` over a real action client, bridge and board."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chain import FAST_BAUD, Chain
from interface_build import action_environment
from rclpy.serialization import deserialize_message
from servo_msgs_py.run_file.reader import RunReader
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

CLIENT = Path(__file__).with_name("follow_action_client.py")


class Answers:
    """Results of the client by case, as it prints them: a test waits for its own case only.

    Parameters
    ----------
    process : Popen
        The client; every step has a time-out.
    errors : Path
        Its standard error.
    recording : Path
        Of the bridge.
    """

    def __init__(self, process: subprocess.Popen[str], errors: Path, recording: Path) -> None:
        self._process, self._errors, self.recording = process, errors, recording
        self._found: dict[str, dict[str, Any]] = {}

    def __getitem__(self, case: str) -> dict[str, Any]:
        assert self._process.stdout is not None
        while case not in self._found:
            line = self._process.stdout.readline()
            assert line, f"{list(self._found)}\n{self._errors.read_text()[-4000:]}"
            if line.startswith("{"):
                answer = json.loads(line)
                self._found[answer["case"]] = answer
        return self._found[case]


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Answers]:
    folder = tmp_path_factory.mktemp("action")
    chain = Chain(folder, FAST_BAUD, action_environment(), "ideal")
    try:
        chain.board()
        chain.bridge(run_file=str(folder / "run.mcap"))
        with (
            (folder / "errors").open("w") as errors,
            subprocess.Popen(
                [sys.executable, str(CLIENT)], stdout=subprocess.PIPE, stderr=errors, text=True, env=chain.environment
            ) as client,
        ):
            try:
                yield Answers(client, folder / "errors", folder / "run.mcap")
            finally:
                client.kill()
    finally:
        chain.end()
        print(chain.logs())


@pytest.mark.parametrize(
    ("case", "status", "code", "text"),
    [
        ("succeeds", "SUCCEEDED", 0, "Goal successfully reached!"),
        ("one_joint", "SUCCEEDED", 0, "Goal successfully reached!"),
        ("cancelled", "CANCELED", 0, "cancelled"),
        ("longest", "CANCELED", 0, "cancelled"),
        ("preempted", "ABORTED", -1, "Current goal preempted by new incoming action."),
        ("path_tolerance", "ABORTED", -4, "position of axis1 deviates by "),
        ("goal_tolerance", "ABORTED", -5, "Aborted due to goal_time_tolerance exceeding by "),
        ("unknown_joint", "ABORTED", -2, "joint 'elbow' does not exist; the joints are axis1, axis2"),
        ("old_stamp", "ABORTED", -3, "the trajectory ended "),
        ("future_stamp", "SUCCEEDED", 0, "Goal successfully reached!"),
        ("withdrawn", "CANCELED", 0, "cancelled before it began"),
        ("too_fast", "ABORTED", -1, "is above its limit"),
        ("empty", "SUCCEEDED", 0, "the joints have stopped and hold"),
        ("set_point", "ABORTED", -1, "a set-point on joint_commands took over"),
        ("disabled", "ABORTED", -1, "disabled by the service enable"),
    ],
)
def test_each_goal_ends_with_its_status_and_code(
    answers: Answers, case: str, status: str, code: int, text: str
) -> None:
    answer = answers[case]
    assert (answer["status"], answer["code"]) == (status, code), answer
    assert text in answer["text"]


def test_successful_goal_reaches_target_with_feedback(answers: Answers) -> None:
    answer = answers["succeeds"]
    assert answer["distances"] == pytest.approx([3.0, 3.0], abs=0.02)
    assert answer["feedback"] >= 5
    assert answer["joints"] == ["axis1", "axis2"]
    assert answer["errors"] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_joint_not_in_the_goal_does_not_move(answers: Answers) -> None:
    assert answers["one_joint"]["distances"] == pytest.approx([0.0, 1.0], abs=0.02)


@pytest.mark.parametrize("case", ["cancelled", "path_tolerance", "preempted", "set_point"])
def test_aborted_goal_stops_all_its_joints(answers: Answers, case: str) -> None:
    assert max(map(abs, answers[case]["distances"])) < 20.0, "of 30 rad"


def test_new_goal_preempts_the_active_goal(answers: Answers) -> None:
    assert answers["preempted"]["second"] == "SUCCEEDED"
    assert answers["empty"]["first"] == "ABORTED"


def test_cancelled_future_goal_leaves_the_active_goal_running(answers: Answers) -> None:
    assert answers["withdrawn"]["first"] == "SUCCEEDED"


def test_goal_starts_at_its_future_stamp(answers: Answers) -> None:
    assert answers["future_stamp"]["lasted"] > 1.4


def test_goals_and_their_results_are_recorded(answers: Answers) -> None:
    """The trajectory as it arrived, and the call with its tolerances, by the id of the goal."""
    deadline = time.monotonic() + 60.0
    trajectory, request, response = None, None, None
    assert answers["succeeds"]["status"] == "SUCCEEDED"
    while trajectory is None or response is None:
        assert time.monotonic() < deadline, (trajectory, request, response)
        time.sleep(0.5)  # a recording is written once a second
        records = list(RunReader(answers.recording).records(["/servo/follow_joint_trajectory/goals", "/servo/calls"]))
        goals = [one.data for one in records if one.topic.endswith("goals")]
        trajectory = deserialize_message(goals[0], JointTrajectory) if goals else None
        calls = [json.loads(deserialize_message(one.data, String).data) for one in records if one.data not in goals]
        calls = [call for call in calls if call["service"] == "/servo/follow_joint_trajectory"]
        request = next((call["request"] for call in calls if "request" in call), None)
        ids = [] if request is None else [request["goal_id"]]
        response = next((c["response"] for c in calls if "response" in c and c["response"]["goal_id"] in ids), None)
    assert request is not None
    assert trajectory.joint_names == ["axis1", "axis2"]
    assert trajectory.points[-1].positions
    assert request["goal_tolerance"] == []
    assert response["result"]["error_code"] == 0
